"""Operation counts: the printed formulas evaluated, and our own counts.

n joints, f flexible links (n_f in the papers), m modes each. Multiplications come first.
"""

import json
from collections.abc import Callable
from math import nan

from benchmarks.output import RESULTS
from benchmarks.speed.operations import PUBLISHED, STEPS
from benchmarks.validation.entries import INCOMPARABLE, LOST, Number, Table, as_printed

COUNTED = RESULTS / "operations.json"
CHAPTER = "Operation counts"
NOTES = {CHAPTER: "The printed formulas evaluated; n joints, f flexible links of m modes each."}
Pair = tuple[float, float]


def gibbs_appell(n: int, f: int, m: int) -> Pair:
    """Korayem and Shafei, table 2, their method."""
    return PUBLISHED["gibbs_appell"].pair(n, f, m)


def book(n: int, f: int, m: int) -> Pair:
    """Korayem and Shafei, table 2, Book's recursive Lagrangian."""
    return PUBLISHED["book"].pair(n, f, m)


def _steps(n: int, f: int, m: int) -> Pair:
    products, sums = zip(*(step.pair(n, f, m) for step in STEPS), strict=True)
    return sum(products), sum(sums)


RIGID: dict[str, tuple[Callable[[int], Pair], str]] = {  # Cyril, table 2.2: method, N = 6 printed
    "Uicker and Kahn": (
        lambda N: (
            32.5 * N**4 + 86.41666667 * N**3 + 171.25 * N**2 + 53.33333333 * N - 128,
            25 * N**4 + 66.33333333 * N**3 + 129.5 * N**2 + 42.33333333 * N - 96,
        ),
        "67143 51548",
    ),
    "Waters": (
        lambda N: (106.5 * N**2 + 620.5 * N - 512, 82 * N**2 + 514 * N - 384), "7045 5652",
    ),
    "Hollerbach, 4x4": (lambda N: (830 * N - 592, 675 * N - 464), "4388 3586"),
    "Hollerbach, 3x3": (lambda N: (412 * N - 277, 320 * N - 201), "2195 1719"),
    "Kazerounian and Gupta": (lambda N: (136 * N, 118 * N), "816 708"),
    "Khalil et al.": (lambda N: (105 * N - 92, 94 * N - 86), "538 478"),
    "Ma": (lambda N: (109 * N - 109, 95 * N - 108), "545 462"),
    "Cyril": (lambda N: (100 * N - 107, 88 * N - 96), "493 432"),
}  # fmt: skip
CYRIL_STEPS: tuple[tuple[tuple[int, int], tuple[int, int]], ...] = (  # table 2.1: a N + b
    ((4, -4), (0, 0)), ((8, -13), (6, -11)), ((10, -15), (8, -13)), ((19, -20), (14, -17)),
    ((15, -10), (18, -13)), ((3, 0), (0, 0)), ((15, -12), (15, -15)), ((26, -33), (24, -25)),
    ((0, 0), (3, -2)), ((0, 0), (0, 0)),
)  # fmt: skip

_BOTH = ("multiplications", "additions")
_EXACT = "exactly"


def _case(title: str, formula: Callable[[int, int, int], Pair], case: tuple[int, int, int],
          digits: str, remark: str = "") -> Table:  # fmt: skip
    return Table(
        chapter=CHAPTER, title=f"{title} at (n, f, m) = {case}", demand=_EXACT,
        rows=as_printed(_BOTH, digits, remark=remark), ours=lambda: formula(*case),
    )  # fmt: skip


def _misprints() -> list[Table]:
    """Tables whose printed case or count differs from the printed formulas."""
    return [
        Table(
            chapter=CHAPTER, title="Korayem's first case, labelled m = 3", demand=_EXACT,
            rows=tuple(
                Number(
                    quantity=f"{what}, {method}", printed=printed, within=0.5, correct=correct,
                    remark="the printed counts are those of m = 2",
                )
                for what, method, printed, correct in (
                    ("multiplications", "Book", "25251", 34593),
                    ("additions", "Book", "24569", 33653),
                    ("multiplications", "Gibbs-Appell", "19557", 26508),
                    ("additions", "Gibbs-Appell", "18332", 26966),
                )
            ),
            ours=lambda: [*book(6, 6, 3), *gibbs_appell(6, 6, 3)],
        ),
        Table(
            chapter=CHAPTER, title="Book's anthropomorphic case (6, 2, 3)", demand=_EXACT,
            rows=(
                Number(
                    quantity="multiplications", printed="12009", within=0.5, correct=11361,
                    remark="the formula that gives (3, 2, 2) gives 648 less",
                ),
                Number(
                    quantity="over Walker and Orin's 4491", printed="2.67", within=0.0051,
                    remark="of the printed 12 009",
                ),
            ),
            ours=lambda: [book(6, 2, 3)[0], 12009 / 4491],
        ),
        Table(
            chapter=CHAPTER, title="Cyril, table 2.2, N = 6, doubtful digits", demand=_EXACT,
            rows=(
                Number(
                    quantity="Walker and Orin, additions", printed="585", within=0.5, correct=595,
                    remark="the formula 101 N - 11; perhaps a misread digit",
                ),
                Number(
                    quantity="McInnis and Liu, multiplications", printed="754", within=0.5,
                    correct=757, remark="the formula 134 N - 47; perhaps a misread digit",
                ),
            ),
            ours=lambda: [101 * 6 - 11, 134 * 6 - 47],
        ),
    ]  # fmt: skip


def _unprinted() -> Table:
    """The formulas for cases without a printed count: few flexible links, the smallest arm."""
    cases = ((6, 2, 3), (2, 2, 1))
    methods: tuple[tuple[str, Callable[[int, int, int], Pair]], ...] = (
        ("Gibbs-Appell", gibbs_appell), ("Book", book),
    )  # fmt: skip
    return Table(
        chapter=CHAPTER, title="The formulas where no count is printed", demand="shown",
        rows=(
            *(
                Number(
                    quantity=f"{name} at {case}, {what}", printed="", claim=INCOMPARABLE,
                    remark="Gibbs-Appell multiplies more than Book" * (case[1] < case[0]),
                )
                for case in cases for name, _ in methods for what in _BOTH
            ),
            Number(
                quantity="Book: 4x4 matrices over Newton-Euler, 12 coordinates", printed="2.66",
                claim=LOST, remark="what was counted is not said",
            ),
        ),
        ours=lambda: [*(x for case in cases for _, count in methods for x in count(*case)), nan],
    )  # fmt: skip


def _cyril() -> list[Table]:
    names = [f"{method}, {what}" for method in RIGID for what in _BOTH]
    sums = [sum(pair[kind][part] for pair in CYRIL_STEPS) for kind in (0, 1) for part in (0, 1)]
    return [
        Table(
            chapter=CHAPTER, title="Rigid inverse dynamics, Cyril, table 2.2, N = 6", demand=_EXACT,
            rows=as_printed(names, " ".join(digits for _, digits in RIGID.values())),
            ours=lambda: [x for formula, _ in RIGID.values() for x in formula(6)],
        ),
        Table(
            chapter=CHAPTER, title="Cyril, table 2.1: the steps add up to 100 N - 107, 88 N - 96",
            demand=_EXACT,
            rows=as_printed(
                ("multiplications, N", "constant", "additions, N", "constant"), "100 -107 88 -96"
            ),
            ours=lambda: sums,
        ),
    ]  # fmt: skip


def counted() -> list[Table]:
    """Printed counts and our own for M and h, as `benchmarks.speed.operations` stored them."""
    if not COUNTED.exists():
        return []
    found = json.loads(COUNTED.read_text())
    printed = {tuple(entry["size"]): entry for entry in found["published"]}
    of_general_arms = [
        (f"{case['formulation']}, {tuple(case['size'])}", tuple(case["size"]), case)
        for case in found["cases"]
        if case["arm"] == "general"
        and case["rotation"] == "linear"
        and case["formulation"] in PUBLISHED
    ]
    of_six_links = [
        ("the preset six-link, folded", (6, 6, 2), entry)
        for entry in found["presets"]
        if entry["preset"] == "six-link" and entry["formulation"] == "gibbs_appell"
    ]
    entries = [
        (f"{name}, {kind}", printed[size][case["formulation"]][kind], case["M and h"][kind])
        for name, size, case in [*of_general_arms, *of_six_links]
        for kind in ("multiplications", "additions")
    ]
    return [
        Table(
            chapter=CHAPTER, title="Our code, counted by running it: M and h",
            demand="shown: other algorithms, folded constants, shared products",
            rows=tuple(
                Number(quantity=name, printed=str(theirs), claim=INCOMPARABLE,
                       remark="n, n_f, m; see docs/formulations.md")
                for name, theirs, _ in entries
            ),
            ours=lambda: [float(ours) for _, _, ours in entries],
        )
    ]  # fmt: skip


def tables() -> list[Table]:
    """All tables of this chapter."""
    return [
        _case("Gibbs-Appell", gibbs_appell, (6, 6, 2), "19557 18332", "printed as m = 3"),
        _case("Book", book, (6, 6, 2), "25251 24569", "printed as m = 3"),
        _case("Gibbs-Appell", gibbs_appell, (3, 2, 2), "2706 2134"),
        _case("Book", book, (3, 2, 2), "4922 4851"),
        _case("Korayem, table 1, sum of the ten steps", _steps, (6, 6, 2), "19557 18332",
              "with 9 n² - 9 in step 10, where the print is unreadable"),
        _case("Korayem, table 1, sum of the ten steps", _steps, (3, 2, 2), "2706 2134"),
        *_misprints(),
        _unprinted(),
        *_cyril(),
        *counted(),
    ]  # fmt: skip
