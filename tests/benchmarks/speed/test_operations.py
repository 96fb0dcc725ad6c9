"""Published operation counts, and our own counts compared with them and with the stored ones."""

import json

import casadi as ca
import pytest

from benchmarks.speed import operations
from dynamics import compile_arm
from dynamics.formulations.table import FORMULATIONS
from dynamics.tracing.operation_counts import operations as counted
from tests.paths import ROOT

# ---- published -----------------------------------------------------------------------------------

PRINTED = [  # formulation, (n, flexible, m), multiplications, additions
    ("book", (6, 6, 2), 25_251, 24_569),
    ("gibbs_appell", (6, 6, 2), 19_557, 18_332),
    ("book", (3, 2, 2), 4_922, 4_851),
    ("gibbs_appell", (3, 2, 2), 2_706, 2_134),
]


@pytest.mark.parametrize(("name", "size", "multiplications", "additions"), PRINTED)
def test_formulas_give_the_printed_numbers(
    name: str, size: tuple[int, int, int], multiplications: int, additions: int
) -> None:
    """Korayem & Shafei (2009), Table 2."""
    found = operations.published(name, operations.Case(*size))
    assert found == {"multiplications": multiplications, "additions": additions}


def test_the_first_printed_case_has_two_modes_and_not_three() -> None:
    """The table prints m = 3; no other small case gives all four numbers."""
    printed = [(name, products, sums) for name, size, products, sums in PRINTED[:2]]
    matches = []
    for n in range(1, 10):
        for flexible in range(1, n + 1):
            for m in range(1, 7):
                case = operations.Case(n, flexible, m)
                if all(
                    operations.published(name, case) == {"multiplications": x, "additions": y}
                    for name, x, y in printed
                ):
                    matches.append((n, flexible, m))
    assert matches == [(6, 6, 2)]
    assert (
        operations.published("gibbs_appell", operations.Case(6, 6, 3))["multiplications"] == 26_508
    )


@pytest.mark.parametrize("size", [(6, 6, 2), (3, 2, 2), (6, 2, 3), (4, 3, 1)])
def test_the_steps_of_table_1_add_up_to_table_2(size: tuple[int, int, int]) -> None:
    whole = operations.PUBLISHED["gibbs_appell"]
    for kind in ("multiplications", "additions"):
        steps = sum(getattr(step, kind)(*size) for step in operations.STEPS)
        assert steps == pytest.approx(getattr(whole, kind)(*size), rel=1e-14)


def test_with_few_flexible_links_the_published_recursion_is_costlier() -> None:
    """In multiplications. Book's text prints 12 009 where its formula gives 11 361."""
    few = operations.Case(6, 2, 3)
    recursion, book = (operations.published(name, few) for name in ("gibbs_appell", "book"))
    assert (recursion["multiplications"], book["multiplications"]) == (13_620, 11_361)
    assert recursion["additions"] < book["additions"]
    assert 12_009 - book["multiplications"] == 18 * few.n**2


# ---- counted -------------------------------------------------------------------------------------


def test_equal_indices_of_different_inputs_are_different_values() -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 2)
    outputs = ca.vertcat(x[0] * x[1] + y[0] * y[1], ca.sin(x[0]) / y[1], x[0] + x[0])
    graph = ca.Function("f", [x, y], [outputs])

    found = counted(graph)

    assert found == {
        "multiplications": 4, "additions": 1, "divisions": 1, "sines and cosines": 1,
    }  # fmt: skip
    assert counted(graph, offline=1) == {
        "multiplications": 2, "additions": 1, "divisions": 1, "sines and cosines": 0,
    }  # fmt: skip


def test_six_links_take_a_fifth_of_the_published_operations() -> None:
    counts = compile_arm(operations.one_shape_per_plane()).operation_count()["mass matrix and bias"]
    assert counts["multiplications"] <= 4_000 < 19_557 / 4
    assert counts["additions"] <= 3_300 < 18_332 / 5


@pytest.mark.parametrize("name", FORMULATIONS)
def test_the_stored_counts_are_reproduced(name: str) -> None:
    """For the small case, general and given; versions of CasADi fold slightly differently."""
    saved = json.loads((ROOT / "docs" / "results" / "operations.json").read_text())
    case = operations.Case(3, 2, 2)
    arm = operations.given_arm(case)
    general, symbols = operations.general_chain(case, "exp")
    for kind, chain, constants in (
        ("general", general, symbols), ("given", compile_arm(arm).chain, []),
    ):  # fmt: skip
        key = {"size": [3, 2, 2], "arm": kind, "formulation": name, "rotation": "exp"}
        (row,) = [row for row in saved["cases"] if key.items() <= row.items()]
        found = operations.count(name, chain, arm.n, arm.n_joint, constants)
        for question, counts in found.items():
            for operation in ("multiplications", "additions", "divisions"):
                expected = row[question][operation]
                assert counts[operation] == pytest.approx(expected, rel=0.02), (kind, question)


def test_no_constant_of_a_general_arm_folds_away() -> None:
    """M and h depend on every entry of every integral of an inner link."""
    case = operations.Case(3, 3, 2)
    chain, _ = operations.general_chain(case, "linear")
    equations = FORMULATIONS["gibbs_appell"].equations
    q, v = ca.SX.sym("q", 9), ca.SX.sym("v", 9)
    M = equations.mass_matrix(chain, ca.vertsplit(q))
    h = equations.bias(chain, ca.vertsplit(q), ca.vertsplit(v))
    outputs = ca.vertcat(*(x for row in M for x in row), *h)
    used = {x.name() for x in ca.symvar(outputs)}
    inner = chain.links[1]

    for field in (
        "length", "mass", "first_moment", "epsilon", "s", "c", "C", "D", "C0", "tip_phi",
        "tip_theta", "K", "rotation",
    ):  # fmt: skip
        symbols = {x.name() for x in entries(getattr(inner, field))}
        assert symbols, field
        assert symbols <= used, field


def entries(value: object) -> list[ca.SX]:
    """All numbers of a nested tuple."""
    if isinstance(value, tuple):
        return [entry for part in value for entry in entries(part)]
    return [value]
