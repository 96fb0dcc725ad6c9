"""Straight-line Python to LLVM vector code, without numba's type inference.

A generated function has one form only: `x3 = w[2]`, `x7 = x3 * x5`, `x8 = floor(x7)`, `w[9] = x8`,
where `w[s]` stands for slot s of every lane. Type inference would take half a millisecond per
operation, and the loop vectoriser's success would be a matter of luck; emitting the operations on
vectors of all lanes is a hundred times faster and certain, and LLVM fits them to the machine.
"""

import ast
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.cgutils import for_range
from numba.extending import intrinsic

_FLAGS = ("contract", "arcp", "nsz")  # never nnan or ninf: a NaN must survive to be seen


def straight_line(lanes: int, rounds: int = 1) -> Callable[[Callable[..., None]], Any]:
    """Decorator: a generated function of `w` becomes one for this many lanes, for njit's to call.

    In several rounds, each for its share of the lanes, fewer numbers are on the way at a time: good
    for a function that has few operations on each.
    """
    width = -(-lanes // rounds)

    def decorate(function: Callable[..., None]) -> Any:
        @intrinsic
        def call(typingctx, w):  # type: ignore[no-untyped-def]
            def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
                data = context.make_array(signature.args[0])(context, builder, args[0]).data
                number = context.get_value_type(w.dtype)
                builder.call(_defined(builder.module, function, number, lanes, width), [data])
                return context.get_dummy_value()

            return types.void(w), codegen

        return call

    return decorate


def _defined(
    module: ir.Module, function: Callable[..., None], number: ir.Type, lanes: int, width: int
) -> ir.Function:
    """The function in the module of its caller, which optimizes and keeps it once, for itself."""
    known = module.globals.get(function.__name__)
    if known is not None:
        return known
    kind = ir.FunctionType(ir.VoidType(), [number.as_pointer()])
    defined = ir.Function(module, kind, function.__name__)
    defined.linkage = "internal"
    defined.attributes.add("noinline")  # called often: one copy is enough
    defined.attributes.add("nounwind")
    builder = ir.IRBuilder(defined.append_basic_block())
    tree = ast.parse(inspect.getsource(function)).body[0]
    assert isinstance(tree, ast.FunctionDef)
    with for_range(builder, ir.IntType(64)(lanes // width)) as loop:
        data = builder.gep(defined.args[0], [builder.mul(loop.index, loop.index.type(width))])
        _Block(builder, data, number, lanes, width).emit(tree.body)
    builder.ret_void()
    return defined


def lane_moves(lanes: int) -> tuple[Any, Any]:
    """Functions `take` and `put`: all lanes of a slot from, and to, consecutive array elements.

    `take(w, at, array, first)` and `put(w, at, array, first)`; offsets count elements of the flat
    array. Numbers are converted; in an array of flags all but zero is true.
    """

    def vector(number: ir.Type) -> ir.Type:
        return number if lanes == 1 else ir.VectorType(number, lanes)

    def pointer(context, builder, kind, array, offset):  # type: ignore[no-untyped-def]
        data = context.make_array(kind)(context, builder, array).data
        address = builder.gep(data, [offset])
        return builder.bitcast(address, vector(address.type.pointee).as_pointer())

    def convert(builder, value, number):  # type: ignore[no-untyped-def]
        kind = vector(number)
        if isinstance(number, ir.IntType):
            zero = ir.Constant(value.type, [0.0] * lanes if lanes > 1 else 0.0)
            return builder.zext(builder.fcmp_unordered("!=", value, zero), kind)
        if value.type == kind:
            return value
        narrower = isinstance(number, ir.FloatType)
        return builder.fptrunc(value, kind) if narrower else builder.fpext(value, kind)

    def move(inwards: bool) -> Any:
        @intrinsic
        def lanes_moved(typingctx, w, at, array, first):  # type: ignore[no-untyped-def]
            def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
                slot = pointer(context, builder, signature.args[0], args[0], args[1])
                place = pointer(context, builder, signature.args[2], args[2], args[3])
                source, target = (place, slot) if inwards else (slot, place)
                number = context.get_data_type(signature.args[0 if inwards else 2].dtype)
                size = context.get_abi_sizeof(context.get_data_type(w.dtype))
                other = context.get_abi_sizeof(context.get_data_type(array.dtype))
                aligns = (other, size) if inwards else (size, other)
                value = convert(builder, builder.load(source, align=aligns[0]), number)
                builder.store(value, target, align=aligns[1])
                return context.get_dummy_value()

            return types.void(w, at, array, first), codegen

        return lanes_moved

    return move(inwards=True), move(inwards=False)


class _Block:
    """Emits statements on values of one type: a number, or a vector of lanes."""

    def __init__(
        self, builder: ir.IRBuilder, data: ir.Value, number: ir.Type, lanes: int, width: int
    ) -> None:
        self.builder, self.data, self.lanes, self.width = builder, data, lanes, width
        self.single = isinstance(number, ir.FloatType)
        self.kind = number if width == 1 else ir.VectorType(number, width)
        self.align = 4 if self.single else 8
        self.values: dict[str, ir.Value] = {}

    def emit(self, statements: list[ast.stmt]) -> None:
        for statement in statements:
            if not isinstance(statement, ast.Assign):
                continue  # the docstring
            value = self._value(statement.value)
            target = statement.targets[0]
            if isinstance(target, ast.Name):
                self.values[target.id] = value
            else:
                assert isinstance(target, ast.Subscript)
                self.builder.store(value, self._slot(target), align=self.align)

    def _slot(self, node: ast.Subscript) -> ir.Value:
        slot = ast.literal_eval(node.slice)
        offset = ir.IntType(64)(slot * self.lanes)
        address = self.builder.gep(self.data, [offset])
        return self.builder.bitcast(address, self.kind.as_pointer())

    def _value(self, node: ast.expr) -> ir.Value:
        b = self.builder
        match node:
            case ast.Name():
                return self.values[node.id]
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
