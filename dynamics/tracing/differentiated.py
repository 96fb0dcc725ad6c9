"""Derivatives of a program: a control step in, a recording step and its derivatives out.

Of a motion, the motion that takes derivatives along a direction with it.

Every slot of the workspace gets a mirror (`tracing.adjoint`), and so has every array of the caller.
Going back needs the numbers that functions read. So the recording step saves on a stack what a
function is about to overwrite, where the adjoint of an earlier one needs it; `pull_back` undoes the
calls in reverse. An environment that is lost, and the start of an episode, have no derivatives: the
caller puts zero there.

The accelerations a solve F(q, v, tau, a) = 0, where F = B tau - h - M a is a short recursion. So
the adjoint of their long elimination is not needed: if c is the cotangent of a, the adjoint of F
takes x = M^-1 c back to q, v and tau, and x costs less than a second evaluation.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import groupby

from dynamics.tracing import graphs
from dynamics.tracing.adjoint import adjoint, loads, stores, tangent
from dynamics.tracing.assembly import Program
from dynamics.tracing.function import Function, traced, written
from dynamics.tracing.ssa import Code
from dynamics.tracing.statements import (
    Call,
    Clear,
    ControlStep,
    Copy,
    Derivatives,
    Load,
    Motion,
    Noise,
    Pop,
    Push,
    Rows,
    Statement,
    Statements,
    Store,
    Substeps,
)
from dynamics.tracing.traced_arm import TracedArm

MIRROR = "_MIRROR"  # ending of the names of mirrored slots
SOLVED = "accelerations"
EQUATIONS = "IMBALANCE"  # slots of F, which has a place in the step's order, but does not run


def differentiated(program: Program, arm: TracedArm | None = None) -> Program:
    """The program with mirrored slots: `Derivatives` of its control step, or a `Motion`.

    With the arm, the adjoint of the accelerations is made from the equations that they solve.
    """
    if isinstance(program.entry, ControlStep):
        return _of_step(program, program.entry.step, arm)
    if isinstance(program.entry, Motion):
        return _of_motion(program, program.entry)
    raise TypeError(f"Only control steps and motions have derivatives, not {program.entry!r}.")


def _of_motion(program: Program, motion: Motion) -> Program:
    made = _Derivation(program, (*motion.begin, *motion.step))
    begin = (made.cleared, *made.pushed_forward(motion.begin))
    step = tuple(made.pushed_forward(made.flattened(motion.step)))
    return _mirrored_program(program, made, Motion(begin=begin, step=step))


def _of_step(program: Program, statements: Statements, arm: TracedArm | None) -> Program:
    if arm is not None and arm.formed.recursion is None:
        arm = None
    if arm is not None:
        sizes, at = {**program.sizes, EQUATIONS: arm.n}, {**program.at, EQUATIONS: program.slots}
        program = replace(program, sizes=sizes, at=at, slots=program.slots + arm.n)
    made = _Derivation(program, statements, arm)
    step = tuple(made.flattened(statements))
    record = made.recorded(step)
    end = made.kept_to_the_end()
    entry = Derivatives(
        record=tuple(_running([*record, *end])),
        pull_back=tuple(made.pulled_back(step, record, end)),
        push_forward=(made.cleared, *made.pushed_forward(_running(step))),
        fixed=sum(x.count for x in (*record, *end) if isinstance(x, Push)),
        per_substep=sum(
            y.count
            for x in record if isinstance(x, Substeps)
            for y in x.body if isinstance(y, Push)
        ),
    )  # fmt: skip
    return _mirrored_program(program, made, entry)


def _mirrored_program(
    program: Program, made: "_Derivation", entry: Derivatives | Motion
) -> Program:
    mirrored = {name + MIRROR: size for name, size in program.sizes.items()}
    return replace(
        program,
        title=f"{program.title}, derivatives",
        sizes={**program.sizes, **mirrored},
        at={
            **program.at,
            **{name + MIRROR: program.slots + program.at[name] for name in program.sizes},
        },
        slots=2 * program.slots,
        further=[*program.further, *made.functions],
        routines={},
        entry=entry,
    )


def _running(statements: Iterable[Statement]) -> Iterable[Statement]:
    """Statements without the place of the equations of motion."""
    for statement in statements:
        if isinstance(statement, Substeps):
            yield Substeps(tuple(_running(statement.body)))
        elif statement != Call(EQUATIONS):
            yield statement


class _Derivation:
    """Derivatives of a program's functions, and what they need.

    Attributes
    ----------
    functions : adjoints, tangents and copies that statements call.
    """

    def __init__(self, program: Program, step: Statements, arm: TracedArm | None = None) -> None:
        self._program, self._arm = program, arm
        self.functions: list[Function] = []
        self._primal = {function.name: function for function in program.functions}
        self._changed = {slot for function in program.functions for slot in stores(function)}
        loaded: set[int] = set()
        for x in step:
            if isinstance(x, Load):
                loaded.update(self._slots(x.slots, x.rows.count))
            elif isinstance(x, Noise):
                self._changed.update(self._slots(x.slots, x.count))
        self._passive = set(range(program.slots)) - self._changed - loaded
        self._adjoints: dict[str, tuple[Statement, ...]] = {}
        self._needs: dict[str, set[int]] = {}  # slots that adjoints read
        self._due: set[int] = set()  # slots whose present numbers an adjoint needs
        if arm is not None:
            self._solve(arm)

    def _slots(self, name: str, count: int) -> range:
        first = self._program.at[name]
        return range(first, first + count)

    @property
    def cleared(self) -> Clear:
        """Zeros in all mirrors."""
        return Clear(next(iter(self._program.sizes)) + MIRROR, self._program.slots)

    def _solve(self, arm: TracedArm) -> None:
        """Adjoint of the accelerations, from the equations that they solve."""
        at, slots = self._program.at, self._program.slots
        acc, implicit = self._slots("ACC", arm.n), self._program.sizes["IMPLICIT"] > 0
        inputs = [at[name] for name in ("Q", "V", "TAU", "PARAMETERS", "IMPLICIT")]
        response = traced(
            "response", graphs.response(arm, implicit), [*inputs, acc[0] + slots],
            slots + at[EQUATIONS],
        )  # fmt: skip
        graph = graphs.imbalance(arm, implicit)
        equations = traced(EQUATIONS, graph, [*inputs, acc[0]], at[EQUATIONS])
        back = adjoint(equations, slots, self._passive - set(stores(equations)) | set(acc))
        self.functions += [response, back]
        self._primal[EQUATIONS] = equations
        self._adjoints[SOLVED], self._needs[SOLVED] = (Clear("ACC" + MIRROR, arm.n),), set()
        self._adjoints[EQUATIONS] = Call(response.name), Call(back.name)
        self._needs[EQUATIONS] = loads(response) | loads(back)

    # ---- the step ----------------------------------------------------------------------------

    def flattened(self, statements: Iterable[Statement]) -> Iterable[Statement]:
        """Statements without routines; copies become calls."""
        for statement in statements:
            match statement:
                case Call(name) if name in self._program.routines:
                    yield from self.flattened(self._program.routines[name])
                case Copy(source, target, rows):
                    yield Call(self._copy(source, target, rows))
                case Call(name) if name == SOLVED and self._arm is not None:
                    yield from (statement, Call(EQUATIONS))
                case Substeps(body):
                    yield Substeps(tuple(self.flattened(body)))
                case _:
                    yield statement

    def _copy(self, source: str, target: str, rows: Rows) -> str:
        """Name of a function that copies slots."""
        code, name = Code(), f"copy_{target.lower()}"
        pairs = zip(self._slots(target, rows.count), self._slots(source, rows.count), strict=True)
        function = written(name, code, {to: code.load(slot) for to, slot in pairs})
        self._primal[name] = function
        self._changed |= set(stores(function))
        self._passive -= self._changed
        self.functions.append(function)
        return name

    # ---- recording ---------------------------------------------------------------------------

    def recorded(self, statements: Statements) -> Statements:
        """Statements that save what is overwritten and still needed."""
        result: list[Statement] = []
        for statement in statements:
            match statement:
                case Call(name):
                    self._adjoint(name)
                    self._due |= self._needs[name] & set(range(self._program.slots))
                    changed = self._due & set(stores(self._primal[name]))
                    self._due -= changed
                    result += [*self._pushes(changed), statement]
                case Substeps(body):
                    before = set(self._due)
                    self.recorded(body)
                    self._due |= before  # a later substep overwrites what an earlier one left due
                    result.append(Substeps(self.recorded(body)))
                case _:
                    result.append(statement)
        return tuple(result)

    def kept_to_the_end(self) -> list[Statement]:
        """Pushes of the numbers that adjoints need as the step left them."""
        return self._pushes(self._due & self._changed)

    def _pushes(self, slots: set[int]) -> list[Statement]:
        """Pushes of runs of slots."""
        runs = groupby(enumerate(sorted(slots)), lambda pair: pair[1] - pair[0])
        found = []
        for _, run in runs:
            numbers = [slot for _, slot in run]
            name = max((at, name) for name, at in self._program.at.items()
                       if at <= numbers[0] and name in self._program.sizes)[1]  # fmt: skip
            found.append(Push(name, numbers[0] - self._program.at[name], len(numbers)))
        return list(found)

    def _adjoint(self, name: str) -> tuple[Statement, ...]:
        """Statements of the adjoint of a function."""
        if name not in self._adjoints:
            made = adjoint(self._primal[name], self._program.slots, self._passive)
            self._adjoints[name], self._needs[name] = (Call(made.name),), loads(made)
            self.functions.append(made)
        return self._adjoints[name]

    # ---- derivatives -------------------------------------------------------------------------

    def pulled_back(
        self, step: Statements, record: Statements, end: Iterable[Statement]
    ) -> Iterable[Statement]:
        """Cotangents of stored rows in, cotangents of loaded rows out."""
        given = [x for x in step if isinstance(x, Load)]
        yield self.cleared
        yield from given
        yield from self._undone(end)
        for load in given:  # rows that the step leaves as they are keep their cotangents
            if load.rows.array == "state":
                yield _mirrored(load)
        for x in step:
            if isinstance(x, Store) and x.rows.array in ("obs", "info"):
                yield Load(x.slots + MIRROR, _mirror_of(x.rows))
        yield from self._undone(record)
        for load in given:
            yield Store(load.slots + MIRROR, _mirror_of(load.rows))

    def _undone(self, statements: Iterable[Statement]) -> Iterable[Statement]:
        """Adjoints of calls, last first, each where its function's pushes are undone."""
        called: list[Statement] = []
        for statement in reversed(list(statements)):
            if isinstance(statement, Push):
                yield Pop(statement.slots, statement.skipped, statement.count)
                continue
            yield from called
            called.clear()
            match statement:
                case Call(name):
                    called += self._adjoint(name)
                case Clear(slots, count):
                    yield Clear(slots + MIRROR, count)
                case Substeps(body):
                    yield Substeps(tuple(self._undone(body)))
        yield from called

    def pushed_forward(self, statements: Iterable[Statement]) -> Iterable[Statement]:
        """The step, whose functions take derivatives along."""
        for statement in statements:
            match statement:
                case Call(name):
                    made = tangent(self._primal[name], self._program.slots, self._passive)
                    if all(made.name != other.name for other in self.functions):
                        self.functions.append(made)
                    yield Call(made.name)
                case Load() | Store():
                    yield statement
                    if statement.rows.array != "flags":
                        yield _mirrored(statement)
                case Clear(slots, count):
                    yield from (statement, Clear(slots + MIRROR, count))
                case Substeps(body):
                    yield Substeps(tuple(self.pushed_forward(body)))
                case Noise():
                    yield statement


def _mirrored(move: Load | Store) -> Load | Store:
    return replace(move, slots=move.slots + MIRROR, rows=_mirror_of(move.rows))


def _mirror_of(rows: Rows) -> Rows:
    return replace(rows, name=rows.name + MIRROR, array=f"{rows.array}_mirror")
