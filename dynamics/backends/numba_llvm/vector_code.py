"""LLVM vector code of straight-line functions, without numba's type inference.

A function is text with statements of one form: `x3 = w[2]`, `x7 = x3 * x5`, `x8 = floor(x7)`,
`w[9] = x8`, where `w[s]` is slot s of every lane. Each operation becomes one LLVM instruction on a
vector of lanes, which LLVM splits into the registers of the machine. This compiles a hundred times
faster than a loop over lanes would: numba infers types at half a millisecond per operation. And it
does not depend on the loop vectoriser.
"""

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from dynamics.runtime.jit import CACHE_LINE
from dynamics.runtime.numba_internals import data_pointer, for_range, get_host_cpu_features

PIECE = 8000  # statements per LLVM function: compile time grows faster than their number
LONG = 700  # statements: shorter scalar functions spill few values to the stack
# All lanes of a value fill several vector registers, which are independent chains of operations.
# A long function has enough independent operations of its own; it processes one register of lanes
# per pass instead, so that more of its live values fit into registers. Statements from which a
# function does so, by bytes of a register: AVX2 has 16 registers, AVX-512 32. Gain:
# docs/results/tricks.md.
NARROW = {32: 1100, 64: 5000}
NARROW_LOOSE = {32: 0, 64: 400}
WORD = ir.IntType(64)
_FLAGS = ("contract", "arcp", "nsz")  # never nnan or ninf: a NaN must survive to be reported


def straight_line(name: str, lanes: int, text: str, loose: bool = False) -> Any:
    """A function `name(w)` of these statements, for compiled functions to call.

    Long functions process one register width of lanes per pass, to limit live values. A `loose`
    function, which uses each of many values once or twice, does so from a smaller length on.
    """
    length = text.count("\n")

    @intrinsic
    def call(typingctx, w):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            data = data_pointer(context, builder, signature.args[0], args[0])
            builder.call(once(builder.module, name, [data], body), [data])
            return context.get_dummy_value()

        return types.void(w), codegen

    def body(builder: ir.IRBuilder, data: ir.Value) -> None:
        if lanes > 1 or length > LONG:
            _lay_out_stack(builder, data)
        register, size = _register(), bytes_of(data.type.pointee)
        least = (NARROW_LOOSE if loose else NARROW)[register]
        width = lanes if length < least else min(lanes, register // size)
        pieces = _pieces(text)
        places = 1 + max((at for piece in pieces for at in piece.left.values()), default=-1)
        passed = builder.alloca(vector(data.type.pointee, width), WORD(places))
        with for_range(builder, WORD(lanes // width)) as loop:
            share = builder.gep(data, [builder.mul(loop.index, WORD(width))])
            for k, piece in enumerate(pieces):
                if len(pieces) == 1:
                    _emit(builder, share, passed, piece, lanes)
                    continue
                given, emit = [share, passed], partial(_emit_apart, piece=piece, lanes=lanes)
                builder.call(once(builder.module, f"{name}_piece_{k}", given, emit), given)

    return call


@cache
def _register() -> int:
    """Bytes of a vector register of the processor that numba compiles for."""
    told = config.CPU_FEATURES
    features = get_host_cpu_features() if told is None else told
    return 64 if "+avx512f" in features.split(",") else 32


def bytes_of(number: ir.Type) -> int:
    """Size of a floating-point number."""
    return 4 if isinstance(number, ir.FloatType) else 8


def vector(number: ir.Type, width: int) -> ir.Type:
    """Type of so many numbers; of one, the number itself."""
    return number if width == 1 else ir.VectorType(number, width)


def once(
    module: ir.Module, name: str, arguments: Sequence[ir.Value], body: Callable[..., None]
) -> ir.Function:
    """An internal function of the module, defined once and never inlined."""
    known = module.globals.get(name)
    if known is not None:
        return known
    kind = ir.FunctionType(ir.VoidType(), [x.type for x in arguments])
    defined = ir.Function(module, kind, name)
    defined.linkage = "internal"
    defined.attributes.add("noinline")  # called often: one copy is enough
    defined.attributes.add("nounwind")
    builder = ir.IRBuilder(defined.append_basic_block())
    body(builder, *defined.args)
    builder.ret_void()
    return defined


def _lay_out_stack(builder: ir.IRBuilder, data: ir.Value) -> None:
    """Align the stack frame to a cache line, with a base register; call this first in a function.

    The platform aligns the stack to 16 bytes only, so by chance every other spilled vector would
    cross a cache line. The dynamic allocation, of zero bytes, makes LLVM address the frame through
    a base register: on x86 an address relative to the stack pointer takes a byte more, in every
    second instruction of a long function. Gain: docs/results/tricks.md.
    """
    builder.function.attributes.alignstack = CACHE_LINE
    none = builder.and_(builder.ptrtoint(data, WORD), WORD(1))
    place = builder.alloca(ir.IntType(8), none)
    builder.asm(ir.FunctionType(ir.VoidType(), [place.type]), "", "r", [place], side_effect=True)


@dataclass
class _Piece:
    """Consecutive statements, and the places that pass values between pieces, by name."""

    statements: list[ast.Assign]
    taken: dict[str, int]  # values of earlier pieces that it reads
    left: dict[str, int]  # values that later pieces read


def _pieces(text: str) -> list[_Piece]:
    """Statements of a function in pieces of at most PIECE."""
    lines = cast(list[ast.Assign], ast.parse(text).body)
    shares = [lines[k : k + PIECE] for k in range(0, len(lines), PIECE)]
    if len(shares) == 1:
        return [_Piece(lines, taken={}, left={})]
    reads = [
        {node.id for line in share for node in ast.walk(line.value) if isinstance(node, ast.Name)}
        for share in shares
    ]
    last = {name: k for k, names in enumerate(reads) for name in names}
    places: dict[str, int] = {}
    free: list[int] = []
    result, size = [], 0
    for k, share in enumerate(shares):
        taken = {name: place for name, place in places.items() if name in reads[k]}
        left = {}
        for line in share:
            target = line.targets[0]
            if not isinstance(target, ast.Name) or target.id in left:
                continue
            if last.get(target.id, k) > k:
                left[target.id] = free.pop() if free else size
                size = max(size, left[target.id] + 1)
        places |= left
        free += [places.pop(name) for name in list(places) if last[name] == k]
        result.append(_Piece(share, taken, left))
    return result


def _emit(
    builder: ir.IRBuilder, data: ir.Value, passed: ir.Value, piece: _Piece, lanes: int
) -> None:
    _Block(builder, data, passed, piece, lanes).emit()


def _emit_apart(
    builder: ir.IRBuilder, data: ir.Value, passed: ir.Value, piece: _Piece, lanes: int
) -> None:
    """Emit a piece as a function of its own."""
    _lay_out_stack(builder, data)
    _emit(builder, data, passed, piece, lanes)


class _Block:
    """Emits statements on values of one type: a number, or a vector of lanes."""

    def __init__(
        self, builder: ir.IRBuilder, data: ir.Value, passed: ir.Value, piece: _Piece, lanes: int
    ) -> None:
        self.builder, self.data, self.passed, self.lanes = builder, data, passed, lanes
        self.piece, self.kind = piece, passed.type.pointee
        self.width = self.kind.count if isinstance(self.kind, ir.VectorType) else 1
        self.single = isinstance(data.type.pointee, ir.FloatType)
        self.align = 4 if self.single else 8
        self.values: dict[str, ir.Value] = {}

    def emit(self) -> None:
        for statement in self.piece.statements:
            value = self._value(statement.value)
            target = statement.targets[0]
            if isinstance(target, ast.Subscript):
                self.builder.store(value, self._slot(target), align=self.align)
                continue
            assert isinstance(target, ast.Name)
            self.values[target.id] = value
            if target.id in self.piece.left:
                self.builder.store(value, self._place(self.piece.left[target.id]))

    def _named(self, name: str) -> ir.Value:
        """A value of this piece, or of an earlier piece, loaded at its first use."""
        if name not in self.values:
            self.values[name] = self.builder.load(self._place(self.piece.taken[name]))
        return self.values[name]

    def _place(self, index: int) -> ir.Value:
        return self.builder.gep(self.passed, [WORD(index)])

    def _slot(self, node: ast.Subscript) -> ir.Value:
        slot = ast.literal_eval(node.slice)
        offset = WORD(slot * self.lanes)
        address = self.builder.gep(self.data, [offset])
        return self.builder.bitcast(address, self.kind.as_pointer())

    def _value(self, node: ast.expr) -> ir.Value:
        b = self.builder
        match node:
            case ast.Name():
                return self._named(node.id)
            case ast.Constant(value=int() | float() as number):
                return self._constant(float(number))
            case ast.Subscript():
                return b.load(self._slot(node), align=self.align)
            case ast.UnaryOp(operand=ast.Constant(value=int() | float() as number)):
                return self._constant(-float(number))
            case ast.UnaryOp():
                return b.fneg(self._value(node.operand), flags=_FLAGS)
            case ast.BinOp():
                operation = {
                    ast.Add: b.fadd, ast.Sub: b.fsub, ast.Mult: b.fmul, ast.Div: b.fdiv,
                }[type(node.op)]  # fmt: skip
                return operation(self._value(node.left), self._value(node.right), flags=_FLAGS)
            case ast.Call(func=ast.Name(id=name)):
                return self._call(name, [self._value(a) for a in node.args])
        raise ValueError(f"No code for {ast.unparse(node)}.")

    def _constant(self, value: float) -> ir.Value:
        value = float(np.float32(value)) if self.single else value
        if isinstance(self.kind, ir.VectorType):
            return ir.Constant(self.kind, [value] * self.width)
        return ir.Constant(self.kind, value)

    def _call(self, name: str, args: list[ir.Value]) -> ir.Value:
        b = self.builder
        if name in ("min", "max"):  # ordered comparisons: a NaN in the first argument survives
            beyond = b.fcmp_ordered(">" if name == "min" else "<", args[0], args[1])
            return b.select(beyond, args[1], args[0])
        if name in ("less", "at_most"):
            holds = b.fcmp_ordered("<" if name == "less" else "<=", args[0], args[1])
            return b.select(holds, self._constant(1.0), self._constant(0.0))
        suffix = ("" if self.width == 1 else f"v{self.width}") + ("f32" if self.single else "f64")
        intrinsic_name = {"floor": "floor", "sqrt": "sqrt", "abs": "fabs"}[name]
        module = b.module
        full = f"llvm.{intrinsic_name}.{suffix}"
        function = module.globals.get(full) or ir.Function(
            module, ir.FunctionType(self.kind, [self.kind]), full
        )
        return b.call(function, args)
