"""From an expression graph to compiled code: CasADi in, cached numba source out.

The source is straight-line code on one workspace `w` of slots, each as many numbers wide as there
are lanes, as text, which emission.py turns into vector code across environments.

Sources are files in the user's cache folder, named by a hash of all that determines them: a warm
start neither traces nor imports CasADi, and a changed recursion has another hash, so that it cannot
run stale.
"""

import hashlib
import math
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from types import ModuleType
from typing import Any

from dynamics import cache
from dynamics.kernels import DIGEST

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


def statements(graph: Any, slots: Sequence[int], expand: bool = True) -> tuple[Code, list[int]]:
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
                raise ValueError(f"No lowering for CasADi operation {op}; add it to lowering.py.")
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
    code, _ = statements(graph, starts, expand=False)
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


_TEXT = {
    "+": "{0} + {1}", "-": "{0} - {1}", "*": "{0} * {1}", "/": "{0} / {1}", "neg": "-{0}",
    "floor": "floor({0})", "sqrt": "sqrt({0})", "abs": "abs({0})",
    "min": "min({0}, {1})", "max": "max({0}, {1})", "less": "less({0}, {1})",
    "at_most": "at_most({0}, {1})",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Addition:
    """What a generated module holds beside an arm's accelerations."""

    key: str  # tells it from other additions to the same arm
    sizes: Mapping[str, int]  # further slots of the workspace: name -> how many
    functions: Callable[[Mapping[str, int]], list[str]]  # all slots -> text of functions of `w`
    entries: str  # text of the functions that Python calls
    marks: Mapping[str, Sequence[str]] = field(default_factory=dict)  # lines it has marks for


def render_function(
    name: str,
    graph: Any,
    inputs: Sequence[int],
    output: int | Sequence[int],
    loose: bool = False,
) -> str:
    """Text of `name(w)`, which reads a graph's inputs and stores its output at these slots.

    `output` is the first of adjoining slots, or the slot of every element; `loose` as
    `emission.straight_line` takes it.
    """
    code, outputs = statements(graph, inputs)
    slots = [output + i for i in range(len(outputs))] if isinstance(output, int) else output
    stores = _earliest_stores(code, outputs, slots)
    lines = []
    for v, (op, args) in enumerate(code.statements):
        if op.startswith("load"):
            lines.append(f"x{v} = w[{op[5:]}]")
        elif v not in code.names:
            lines.append(f"x{v} = {_TEXT[op].format(*(code.text(a) for a in args))}")
        lines += [f"w[{slot}] = {code.text(value)}" for slot, value in stores.get(v, ())]
    return render_lines(name, lines, loose)


def render_lines(name: str, lines: Sequence[str], loose: bool = False) -> str:
    """Text of `name(w)`, of statements as emission.py knows them."""
    end = '""", loose=True)' if loose else '""")'
    return "\n".join([f'{name} = straight_line("{name}", LANES, """', *lines, end, ""])


def render_check(state: Iterable[int], check: int, good: int) -> str:
    """Text of `check(w)`: one more is `good` if the state is finite, and was whenever asked."""
    lines = [f"sum = w[{check}]", *(f"sum = sum + 0.0 * w[{slot}]" for slot in state)]
    lines += [f"w[{check}] = sum", f"w[{good}] = w[{good}] + at_most(abs(sum), 0.0)"]
    return render_lines("check", lines)


def _earliest_stores(
    code: Code, outputs: Sequence[int], slots: Sequence[int]
) -> dict[int, list[tuple[int, int]]]:
    """(slot, value) by the statement they follow: the value's own, or the last that needs the slot.

    A value that waits for the end of a long function would be spilled until then.
    """
    loads = {int(op[5:]): v for v, (op, _) in enumerate(code.statements) if op.startswith("load")}
    stores: dict[int, list[tuple[int, int]]] = {}
    for slot, value in zip(slots, outputs, strict=True):
        stores.setdefault(max(value, loads.get(slot, 0)), []).append((slot, value))
    return stores


def render_module(
    title: str,
    lanes: int,
    slots: int,
    operations: tuple[int, int],
    constants: dict[str, int],
    functions: Sequence[str],
    entries: str,
) -> str:
    """The whole generated module; `constants` are slots, in it offsets of values.

    `title` may be any text: a description's name is in it. `operations` are those of an evaluation
    of the accelerations, and of what was added.
    """
    head = [
        '"""Generated code of one arm; see dynamics/lowering.py."""',
        f"TITLE = {title!a}",  # no other text of a description becomes source
        "import numpy as np",
        "from dynamics.emission import lane_moves, row_moves, straight_line",
        "from dynamics.integrators import INTEGRATORS",
        "from dynamics.kernels import compiled, outermost",
        "from dynamics.sharing import first_turn, take_turn",
        f"LANES = {lanes}",
        f"SLOTS = {slots}",
        f"OPERATIONS = {operations[0]}",
        f"FURTHER_OPERATIONS = {operations[1]}",
    ]
    offsets = [f"{name} = np.uint64({slot * lanes})" for name, slot in constants.items()]
    lines = [f"LANES = np.uint64({lanes})", *offsets]
    return "\n\n".join(["\n".join(head), *functions, "\n".join(lines), entries])


def expanded(text: str, marks: Mapping[str, Sequence[str]]) -> str:
    """Text with other lines, which may be marks again, in place of those that are marks."""
    lines = []
    for line in text.splitlines():
        mark = line.lstrip()
        if mark in marks:
            indent = line[: len(line) - len(mark)]
            own = expanded("\n".join(marks[mark]), marks)
            lines += [indent + other for other in own.splitlines()]
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def hash_of_files(paths: Iterable[Path]) -> str:
    """Hash of what is in these files."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(path.read_bytes())
    return digest.hexdigest()


_importing = threading.RLock()

# as imported: a file edited later does not speak for the code in memory
_SOURCES = hash_of_files(Path(__file__).parent.glob("*.py"))


def fingerprint(*parts: str) -> str:
    """Hash of a description, this package's own sources and the versions that compile it."""
    from importlib.metadata import version

    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() + b"\0")
    digest.update(_SOURCES.encode())
    for package in ("numba", "casadi", "numpy"):
        digest.update(version(package).encode())
    digest.update(sys.version.encode())
    return digest.hexdigest()[:20]


def cached_module(key: str, build: Callable[[], str]) -> ModuleType:
    """The generated module of this key; `build` writes its text where the cache has none."""
    name = f"flexarm_generated_{key}"
    with _importing:
        if name not in sys.modules:
            sys.modules[name] = _executed(name, cache.kept(f"{name}.py", build))
        return sys.modules[name]


def _executed(name: str, text: str) -> ModuleType:
    """A module made of this very text, which was verified; Python's own cache of code was not."""
    module = ModuleType(name)
    module.__file__ = str(cache.cache_folder() / f"{name}.py")
    module.__dict__[DIGEST] = hashlib.sha256(text.encode()).hexdigest()
    sys.modules[name] = module  # numba looks there for the module of a function
    try:
        exec(compile(text, module.__file__, "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module
