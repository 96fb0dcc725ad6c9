"""Statements of a program on the workspace, which a backend prints in its language.

A program is written for one environment. A backend may run it for several side by side, or one per
thread. Straight-line arithmetic is in functions (`tracing.function`); statements move numbers
between the workspace and a caller's arrays, and say what is called in which order.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

# Arrays in which each environment is a row; in all others it is a column.
ROW_PER_ENVIRONMENT = ("actions", "obs", "actions_mirror", "obs_mirror")


@dataclass(frozen=True)
class Rows:
    """Numbers of an environment that follow one another in a caller's array."""

    name: str  # in printed code; equal names are equal rows
    array: str
    first: int
    count: int


@dataclass(frozen=True)
class Call:
    """Call of a function of the workspace, or the statements of the routine of this name."""

    name: str


@dataclass(frozen=True)
class Load:
    """Copy of rows to the slots from the one of this name on."""

    slots: str
    rows: Rows


@dataclass(frozen=True)
class Store:
    """Copy of the slots from the one of this name on to rows; to flags, whether not zero."""

    slots: str
    rows: Rows


@dataclass(frozen=True)
class Copy:
    """Copy of `rows.count` slots to others."""

    source: str
    target: str
    rows: Rows  # as many as slots


@dataclass(frozen=True)
class Clear:
    """Zeros in slots, from the one of this name on."""

    slots: str
    count: int = 1


@dataclass(frozen=True)
class Noise:
    """Nearly normal random numbers of mean 0 and standard deviation 1, in slots.

    They are hashes of two whole numbers in slots, and of their own number.
    """

    slots: str
    count: int
    key: str
    step: str


@dataclass(frozen=True)
class Uniform:
    """Next random numbers in [0, 1) of the environment's stream, in slots (splitmix64)."""

    slots: str
    count: int


@dataclass(frozen=True)
class Push:
    """Copy of slots to the next rows of the array `stack`."""

    slots: str  # name of the first
    skipped: int  # slots after that one
    count: int


@dataclass(frozen=True)
class Pop:
    """Copy of the last rows of the array `stack` back to the slots that they came from."""

    slots: str
    skipped: int
    count: int


@dataclass(frozen=True)
class Prefetch:
    """Hint that rows will be written soon: of this environment, or of the next ones."""

    rows: Rows
    next: bool = False


@dataclass(frozen=True)
class Substeps:
    """Statements that are repeated once a substep."""

    body: tuple["Statement", ...]


@dataclass(frozen=True)
class WhereLost:
    """In environments whose slot `flag` is positive, load rows again, then call functions.

    The functions change nothing in other environments, so they may run there too. A backend whose
    caller cannot refuse actions puts zero where they have left NaN in slots of `given`.
    """

    flag: str
    restored: tuple[Load, ...]
    then: tuple[Call, ...]
    given: tuple[tuple[str, int], ...] = ()  # first slot, and how many


@dataclass(frozen=True)
class WhereEnded:
    """Statements for environments whose first two flags say that the episode has ended."""

    flags: str
    body: tuple["Statement", ...]


Statement = (
    Call | Load | Store | Copy | Clear | Noise | Uniform | Push | Pop | Prefetch | Substeps
    | WhereLost | WhereEnded
)  # fmt: skip
Statements = tuple[Statement, ...]


@dataclass(frozen=True, kw_only=True)
class ControlStep:
    """Program of an environment: a control step, and the report on a new episode."""

    step: Statements
    start: Statements  # of an environment whose episode has begun: observation, info, flags
    routines: Mapping[str, Statements] = field(default_factory=dict)  # by name, for `Call`

    @property
    def statements(self) -> Iterator[Statement]:
        """All statements, also those inside others."""
        yield from walked((*self.step, *self.start))

    @property
    def rows(self) -> dict[str, Rows]:
        """All rows by name."""
        return rows_of((*self.step, *self.start))


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Program of a motion under torques that change at samples."""

    begin: Statements  # loads rows of the array `state`
    step: Statements  # to the next sample: loads rows of `torque`, stores rows of `place`


@dataclass(frozen=True, kw_only=True)
class Derivatives:
    """Programs of a control step and its derivatives; see `tracing.differentiated`."""

    record: Statements  # the step, with a stack of the numbers that `pull_back` needs
    pull_back: Statements  # cotangents of what the step stored, to those of what it loaded
    push_forward: Statements  # the step, with derivatives along a direction
    fixed: int  # rows of the stack
    per_substep: int  # further rows for each substep


def rows_of(statements: Iterable[Statement]) -> dict[str, Rows]:
    """Rows that statements move, by name."""
    found: dict[str, Rows] = {}
    for statement in walked(statements):
        if isinstance(statement, Load | Store | Copy | Prefetch):
            rows = statement.rows
            if found.setdefault(rows.name, rows) != rows:
                raise ValueError(f"{rows} and {found[rows.name]} must not share a name.")
    return found


def walked(statements: Iterable[Statement]) -> Iterator[Statement]:
    """Statements, each followed by those inside it."""
    for statement in statements:
        yield statement
        match statement:
            case Substeps(body) | WhereEnded(_, body):
                yield from walked(body)
            case WhereLost(restored=restored, then=then):
                yield from restored
                yield from then
