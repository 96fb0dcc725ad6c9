"""Straight-line code in single-assignment form, from an expression graph.

The code works on one workspace `w` of slots, each as many numbers wide as there are lanes. Nothing
here knows what the code is compiled by: see `dynamics.backends`.
"""

import math
from collections import Counter
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

Statement = tuple[str, tuple[int, ...]]  # operation, operand numbers

# Chebyshev interpolants in r^2 on |r| <= pi/2, error below 5e-18: sin(r)/r and cos(r)
_SIN = (
    1.0, -0.16666666666666666, 0.008333333333333188, -0.00019841269841209248,
    2.7557319211371395e-06, -2.5052106906928565e-08, 1.6058941846319291e-10,
    -7.643055069294625e-13, 2.7219061281368675e-15,
)  # fmt: skip
_COS = (
    1.0, -0.4999999999999997, 0.04166666666666388, -0.00138888888887731, 2.4801587277434662e-05,
    -2.755731639270276e-07, 2.087656191423543e-09, -1.1462903556350365e-11, 4.6089915978490734e-14,
)  # fmt: skip
_PI = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)  # pi in three parts
_TANH_SATURATES = 20.0  # tanh(20) = 1 - 8e-18


class Code:
    """Straight-line code in single-assignment form; equal operations get equal numbers."""

    def __init__(self) -> None:
        self.statements: list[Statement] = []
        self.names: dict[int, str] = {}  # number -> literal, for constants
        self._numbers: dict[tuple[Any, ...], int] = {}

    def emit(self, op: str, *args: int) -> int:
        """Number of the value `op(args)`."""
        key = (op, *(sorted(args) if op in "+*" else args))
        if key not in self._numbers:
            self._numbers[key] = len(self.statements)
            self.statements.append((op, args))
        return self._numbers[key]

    def constant(self, value: float) -> int:
        """Number of a literal."""
        if not math.isfinite(value):
            raise ValueError(
                f"The arm's equations hold a number that is not finite ({value!r}): its lengths, "
                "masses and stiffnesses are too far apart for double precision."
            )
        number = self.emit(f"const {value!r}")
        self.names[number] = f"({value!r})" if value < 0.0 else repr(value)
        return number

    def text(self, number: int) -> str:
        """How a statement refers to a value."""
        return self.names.get(number, f"x{number}")

    def load(self, slot: int) -> int:
        """Number of an input in the workspace."""
        return self.emit(f"load {slot}")

    def polynomial(self, coefficients: Sequence[float], x: int) -> int:
        """Horner's rule."""
        value = self.constant(coefficients[-1])
        for c in reversed(coefficients[:-1]):
            value = self.emit("+", self.emit("*", value, x), self.constant(c))
        return value

    def sqrt(self, x: int) -> int:
        """Square root; of a square, the magnitude."""
        op, args = self.statements[x]
        if op == "*" and args[0] == args[1]:
            return self.emit("abs", args[0])
        return self.emit("sqrt", x)

    def sin(self, x: int) -> int:
        """Branch-free sine."""
        sign, r = self._reduced(x)
        r_signed = self.emit("*", sign, r)
        return self.emit("*", r_signed, self.polynomial(_SIN, self.emit("*", r, r)))

    def cos(self, x: int) -> int:
        """Branch-free cosine."""
        sign, r = self._reduced(x)
        return self.emit("*", sign, self.polynomial(_COS, self.emit("*", r, r)))

    def _reduced(self, x: int) -> tuple[int, int]:
        """x = k pi + r: the sign from the parity of k, and r.

        Good to 2e-16 for |x| < 1e4 and to 1e-12 for |x| < 1e8.
        """
        emit, constant = self.emit, self.constant
        turns = emit("*", x, constant(0.3183098861837907))
        k = emit("floor", emit("+", turns, constant(0.5)))
        r = x
        for part in _PI:
            r = emit("-", r, emit("*", k, constant(part)))
        even = emit("*", constant(2.0), emit("floor", emit("*", constant(0.5), k)))
        sign = emit("-", constant(1.0), emit("*", constant(2.0), emit("-", k, even)))
        return sign, r

    def tanh(self, x: int) -> int:
        """Branch-free tanh = m / (m + 2), m = expm1(2 x) by a series and ten doublings."""
        emit, constant = self.emit, self.constant
        limit = constant(_TANH_SATURATES)
        x = emit("max", emit("min", x, limit), constant(-_TANH_SATURATES))
        z = emit("*", x, constant(2.0 / 1024.0))
        coefficients, c = [], 1.0
        for k in range(1, 10):
            c /= k
            coefficients.append(c)
        m = emit("*", z, self.polynomial(coefficients, z))
        for _ in range(10):
            m = emit("*", m, emit("+", m, constant(2.0)))
        return emit("/", m, emit("+", m, constant(2.0)))


def from_graph(graph: Any, slots: Sequence[int], expand: bool = True) -> tuple[Code, list[int]]:
    """Single-assignment code of a CasADi SX Function with one output vector.

    `slots[i]` is the workspace slot where input i starts; `expand` writes sin, cos and tanh out.
    Returns the code and the numbers of the output's elements.
    """
    import casadi as ca

    simple = {
        ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_NEG: "neg",
        ca.OP_FABS: "abs", ca.OP_FMIN: "min", ca.OP_FMAX: "max", ca.OP_LT: "less",
        ca.OP_LE: "at_most",
    }  # fmt: skip
    functions = {ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TANH: "tanh"}
    code = Code()
    written_out = {"sin": code.sin, "cos": code.cos, "tanh": code.tanh} if expand else {}
    registers: dict[int, int] = {}
    outputs = [code.constant(0.0)] * graph.nnz_out(0)
    for k in range(graph.n_instructions()):
        op = graph.instruction_id(k)
        args, out = graph.instruction_input(k), graph.instruction_output(k)
        if op == ca.OP_OUTPUT:
            outputs[out[1]] = registers[args[0]]
            continue
        if op == ca.OP_INPUT:
            value = code.load(slots[args[0]] + args[1])
        elif op == ca.OP_CONST:
            value = code.constant(graph.instruction_constant(k))
        else:
            x = [registers[a] for a in args]
            if op == ca.OP_SQRT:
                value = code.sqrt(x[0])
            elif op in simple:
                value = code.emit(simple[op], *x)
            elif op == ca.OP_SQ:
                value = code.emit("*", x[0], x[0])
            elif op == ca.OP_TWICE:
                value = code.emit("+", x[0], x[0])
            elif op in (ca.OP_DIV, ca.OP_INV):  # one division for all quotients by a pivot
                value = code.emit("/", code.constant(1.0), x[-1])
                value = code.emit("*", x[0], value) if op == ca.OP_DIV else value
            elif op in functions:
                name = functions[op]
                value = written_out[name](x[0]) if expand else code.emit(name, x[0])
            else:
                raise ValueError(f"No code for CasADi operation {op}; add it to tracing/ssa.py.")
        registers[out[0]] = value
    return code, outputs


def operations(graph: Any, offline: int = 0) -> dict[str, int]:
    """How many operations of each kind a graph takes; a change of sign is free.

    What follows from the first `offline` inputs alone is worked out beforehand and not counted.
    Doubling, written out as an addition, is a multiplication.
    """
    kinds = {
        "multiplications": ("*",), "additions": ("+", "-"), "divisions": ("/",),
        "sines and cosines": ("sin", "cos"),
    }  # fmt: skip
    starts = [0, *accumulate(graph.nnz_in(k) for k in range(graph.n_in()))]
    code, _ = from_graph(graph, starts, expand=False)
    online: list[bool] = []
    done: Counter[str] = Counter()
    for op, args in code.statements:
        if op.startswith("load"):
            online.append(int(op[5:]) >= starts[offline])
        else:
            online.append(offline == 0 or any(online[x] for x in args))
        doubles = op == "+" and args[0] == args[1]
        done["*" if doubles else op] += online[-1]
    return {kind: sum(done[op] for op in group) for kind, group in kinds.items()}
