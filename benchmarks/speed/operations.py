"""Operations of every formulation, counted by running it, and those of the published formulas.

    python -m benchmarks.speed.operations [--out FILE]

A general arm has a free symbol for every entry of every constant of a link, so that no zero or one
folds away. Operations on constants alone are done once per arm and are not counted, as in the
published formulas. A given arm is the six-link preset, or its first links, with gravity; terms that
are zero on it fold away. Equal operations are counted once; changes of sign, sines and cosines are
not counted.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from benchmarks.output import argument_parser, paragraphs, provenance, save_results, table
from dynamics import ARMS, Arm, Mode, compile_arm
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.link_constants import LinkConstants, chain_constants
from dynamics.formulations.table import FORMULATIONS
from dynamics.tracing.operation_counts import operations

Counts = dict[str, int]
ROTATIONS = ("linear", "exp")
DEFAULT_ARMS = ("slim", "korayem-two-link", "deluca-siciliano", "six-link")


@dataclass(frozen=True)
class Case:
    """n links, n_flexible of them with m modes each; rigid links are link 1 and the last ones."""

    n: int
    n_flexible: int
    m: int

    @property
    def flexible(self) -> range:
        """Indices of the flexible links, from 0."""
        first = 0 if self.n_flexible == self.n else 1
        return range(first, first + self.n_flexible)


CASES = (Case(6, 6, 2), Case(3, 2, 2), Case(6, 2, 3), Case(6, 6, 3))

# ---- published formulas --------------------------------------------------------------------------

Formula = Callable[[float, float, float], float]


@dataclass(frozen=True)
class Published:
    """Operations to form M and h of n links, f of them flexible with m modes each."""

    multiplications: Formula
    additions: Formula

    def pair(self, n: int, f: int, m: int) -> tuple[float, float]:
        """Multiplications and additions."""
        return self.multiplications(n, f, m), self.additions(n, f, m)


# Korayem & Shafei (2009), Table 2: their recursion, and Book's (1984)
PUBLISHED = {
    "gibbs_appell": Published(
        lambda n, f, m: (
            475.5 * n**2 - 790.5 * n + 300 - 15 * m + 6 * m * f + 18 * m**2
            + 42 * m**2 * f**2 + 30 * m * f**2 - 60 * m**2 * f
        ),
        lambda n, f, m: (
            351 * n**2 - 553 * n + 188 + 6 * m - 49.5 * m * f + 18 * m**2
            + 53.5 * m**2 * f**2 + 52.5 * m * f**2 - 89.5 * m**2 * f
        ),
    ),
    "book": Published(
        lambda n, f, m: (
            6 * m**2 * f**2 + 17.5 * m**2 * f + 118 * m * f**2 + 74 * n * f * m + 137.5 * m * f
            + 84 * n**2 + 86 * n * f + 279 * n + 126 * f - 57
        ),
        lambda n, f, m: (
            6.5 * m**2 * f**2 + 19 * m**2 * f + 115.5 * m * f**2 + 68 * n * f * m + 123 * m * f
            + 85 * n**2 + 80 * n * f + 329 * n + 111 * f - 91
        ),
    ),
}  # fmt: skip

# Korayem & Shafei (2009), Table 1: steps 1 to 10 of their recursion. The additions of step 10 begin
# with 9 n^2 - 9: its loops have that many, and with it the steps add up to Table 2.
STEPS = (
    Published(lambda n, f, m: 15 * n - 15, lambda n, f, m: 6 * n - 6),
    Published(lambda n, f, m: 60 * n - 60, lambda n, f, m: 55 * n - 55),
    Published(lambda n, f, m: 66 * n - 27, lambda n, f, m: 54 * n - 21),
    Published(lambda n, f, m: 24 * n - 24, lambda n, f, m: 24 * n - 24),
    Published(lambda n, f, m: 21 * f * m, lambda n, f, m: 17 * f * m),
    Published(lambda n, f, m: 15 * m * f - 15 * m, lambda n, f, m: n - 12 * m + 13 * m * f),
    Published(
        lambda n, f, m: 13.5 * n**2 - 40.5 * n + 27, lambda n, f, m: 9 * n**2 - 27 * n + 18
    ),
    Published(
        lambda n, f, m: 4.5 * n**2 - 13.5 * n + 9, lambda n, f, m: 4.5 * n**2 - 13.5 * n + 9
    ),
    Published(
        lambda n, f, m: 457.5 * n**2 - 901.5 * n + 390,
        lambda n, f, m: 328.5 * n**2 - 652.5 * n + 276,
    ),
    Published(
        lambda n, f, m: (
            30 * m * f**2 - 30 * m * f - 60 * m**2 * f + 18 * m**2 + 42 * m**2 * f**2
        ),
        lambda n, f, m: (
            9 * n**2 - 9 + 52.5 * m * f**2 - 79.5 * m * f + 18 * m - 89.5 * m**2 * f + 18 * m**2
            + 53.5 * m**2 * f**2
        ),
    ),
)  # fmt: skip


def published(name: str, case: Case) -> Counts:
    """Operations of a case by a published formula."""
    pair = PUBLISHED[name].pair(case.n, case.n_flexible, case.m)
    return dict(zip(("multiplications", "additions"), map(round, pair), strict=True))


# ---- arms ----------------------------------------------------------------------------------------


def one_shape_per_plane() -> Arm:
    """The six-link preset as the literature has it: one clamped shape per plane, linear."""
    shapes = tuple(Mode(kind="clamped-tip-mass", index=1, direction=d) for d in "yz")
    whole = ARMS["six-link"]
    links = tuple(
        replace(link, modes=shapes, lumped=False, damping_beta=0.0, damping_ratio=0.01)
        for link in whole.links
    )
    return replace(whole, links=links, foreshortening=False)


def given_arm(case: Case, rotation: str = "exp") -> Arm:
    """The first links of `one_shape_per_plane`, under gravity; the third mode is torsion."""
    whole = one_shape_per_plane()
    links = []
    for i, link in enumerate(whole.links[: case.n]):
        torsion = Mode(kind="torsion-fixed-free", index=1, direction="x")
        modes = (*link.modes, torsion)[: case.m] if i in case.flexible else ()
        links.append(replace(link, modes=modes, GJ=link.EIz, rho_Ip=1e-4 * link.rho_A))
    return replace(whole, links=tuple(links), gravity=(0.0, 0.0, -9.81), rotation=rotation)


class Symbols:
    """Source of new symbols, which it lists in `all`, as scalars, vectors and matrices."""

    def __init__(self) -> None:
        self.all: list[Any] = []

    def one(self) -> Any:
        """A new symbol."""
        self.all.append(ca.SX.sym(f"c{len(self.all)}"))
        return self.all[-1]

    def vector(self) -> tuple[Any, ...]:
        """A new vector (3,)."""
        return tuple(self.one() for _ in range(3))

    def matrix(self) -> tuple[Any, ...]:
        """A new matrix (3, 3)."""
        return tuple(self.vector() for _ in range(3))

    def symmetric(self, size: int) -> tuple[Any, ...]:
        """A new symmetric matrix (size, size)."""
        table = [[0.0] * size for _ in range(size)]
        for i in range(size):
            for j in range(i + 1):
                table[i][j] = table[j][i] = self.one()
        return tuple(map(tuple, table))


def general_link(link: LinkConstants, symbols: Symbols) -> LinkConstants:
    """The link of the published formulas: every constant a symbol, no tip body, no rotor."""
    every = range(len(link.K))
    zero = tuple(tuple(0.0 for _ in row) for row in link.K)
    c_jk: dict[tuple[int, int], Any] = {}
    D: dict[tuple[int, int], Any] = {}
    for j in every:
        c_jk[j, j] = (0.0, 0.0, 0.0)  # r_j x r_j
        D[j, j] = symbols.symmetric(3)
        for k in range(j):
            c_jk[j, k], D[j, k] = symbols.vector(), symbols.matrix()
            c_jk[k, j] = tuple(-x for x in c_jk[j, k])
            D[k, j] = tuple(zip(*D[j, k], strict=True))
    return replace(
        link,
        length=symbols.one(),
        mass=symbols.one(),
        first_moment=symbols.vector(),
        epsilon=tuple(symbols.vector() for _ in every),
        s=symbols.symmetric(len(every)),
        c_jk=tuple(tuple(c_jk[j, k] for k in every) for j in every),
        c=tuple(symbols.vector() for _ in every),
        C=tuple(symbols.matrix() for _ in every),
        D=tuple(tuple(D[j, k] for k in every) for j in every),
        C0=symbols.symmetric(3),
        tip_phi=tuple(symbols.vector() for _ in every),
        tip_theta=tuple(symbols.vector() for _ in every),
        K=symbols.symmetric(len(every)),
        K_pairs=(),
        sines=False,
        damping=zero,
        tip_mass=0.0,
        tip_inertia=((0.0,) * 3,) * 3,
        rotation=symbols.matrix(),
        offset=(0.0, 0.0, 0.0),
        rotor_inertia=0.0,
    )


def general_chain(case: Case, rotation: str) -> tuple[Chain, list[Any]]:
    """A chain of general links under general gravity, and all its symbols."""
    symbols = Symbols()
    bodies = [body for parts in chain_constants(given_arm(case)) for body in parts]
    links = tuple(general_link(body, symbols) for body in bodies)
    return Chain(links, symbols.vector(), rotation), symbols.all


# ---- counting ------------------------------------------------------------------------------------


def count(name: str, chain: Chain, n: int, n_joint: int, constants: list[Any]) -> dict[str, Counts]:
    """Operations of a formulation: for M (one triangle) and h, and for the accelerations."""
    formulation = FORMULATIONS[name]
    q, v, tau = (ca.SX.sym(x, size) for x, size in (("q", n), ("v", n), ("tau", n_joint)))
    x, rates, torques = (ca.vertsplit(y) for y in (q, v, tau))
    M = formulation.equations.mass_matrix(chain, x)
    h = formulation.equations.bias(chain, x, rates)
    half = [entry for i, row in enumerate(M) for entry in row[: i + 1]]
    a = formulation.accelerations(chain, x, rates, torques)
    known = ca.vertcat(*constants)
    return {
        question: operations(ca.Function("counted", [known, *state], [ca.vertcat(*values)]), 1)
        for question, values, state in (
            ("M and h", [*half, *h], [q, v]), ("accelerations", a, [q, v, tau]),
        )
    }  # fmt: skip


def rows() -> Iterator[dict[str, Any]]:
    """One row per arm, formulation and rotation."""
    for case in CASES:
        size = [case.n, case.n_flexible, case.m]
        for rotation in ROTATIONS:
            arm = given_arm(case, rotation)
            general, symbols = general_chain(case, rotation)
            given = compile_arm(arm).chain
            for name in FORMULATIONS:
                for kind, chain, constants in (
                    ("general", general, symbols), ("given", given, []),
                ):  # fmt: skip
                    found = count(name, chain, arm.n, arm.n_joint, constants)
                    yield {"size": size, "arm": kind, "formulation": name, "rotation": rotation} | {
                        **found
                    }


def default_rows() -> Iterator[dict[str, Any]]:
    """One row per default preset and formulation."""
    for preset in DEFAULT_ARMS:
        model = compile_arm(preset)
        for name in FORMULATIONS:
            found = count(name, model.chain, model.n, model.n_joint, [])
            yield {"preset": preset, "coordinates": model.n, "formulation": name, **found}


# ---- page ----------------------------------------------------------------------------------------


def shown(counts: Counts) -> str:
    """The counts as "multiplications + additions"."""
    return f"{counts['multiplications']:,} + {counts['additions']:,}".replace(",", " ")


def page(result: dict[str, Any]) -> str:
    """The tables as Markdown."""
    heads = [f"({', '.join(map(str, case['size']))})" for case in result["published"]]
    parts = [
        "# Operations",
        f"Made by `{result['command']}`. Multiplications + additions by links, flexible links and "
        "modes of each, (n, n_f, m). What each count holds: [formulations](../formulations.md).",
    ]
    questions = ("M and h", "accelerations")
    for question in questions:
        published_rows = [
            ["published formula", f"`{name}`", "linear"]
            + [shown(case[name]) for case in result["published"]]
            for name in PUBLISHED
            if question == "M and h"
        ]
        groups: dict[tuple[str, str, str], list[str]] = {}
        for row in result["cases"]:
            key = (row["arm"], row["formulation"], row["rotation"])
            groups.setdefault(key, []).append(shown(row[question]))
        counted = [
            [arm, f"`{name}`", rotation, *cells]
            for (arm, name, rotation), cells in sorted(groups.items())
        ]
        header = ["arm", "formulation", "E", *heads]
        parts += [f"## {question}", table(header, published_rows + counted, "lllr")]
    presets = [
        [x["preset"], str(x["coordinates"]), f"`{x['formulation']}`"]
        + [shown(x[question]) for question in questions]
        for x in result["presets"]
    ]
    header = ["preset", "coordinates", "formulation", *questions]
    return paragraphs(*parts, "## Presets", table(header, presets, "lrlr"))


def main() -> None:
    """Count, and write JSON and the page."""
    parser = argument_parser("speed.operations", __doc__, "operations.json")
    out = parser.parse_args().out
    result = {
        **provenance("casadi"),
        "published": [
            {"size": [c.n, c.n_flexible, c.m]} | {name: published(name, c) for name in PUBLISHED}
            for c in CASES
        ],
        "cases": list(rows()),
        "presets": list(default_rows()),
    }
    save_results(result, page, out)


if __name__ == "__main__":
    main()
