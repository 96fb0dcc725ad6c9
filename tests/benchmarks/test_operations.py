"""Published operation counts, and our own counts compared with them and with the stored ones."""

import importlib.util
import json
from types import ModuleType

import casadi as ca
import pytest

from dynamics import compile_arm
from dynamics.formulations.table import FORMULATIONS
from dynamics.tracing.operation_counts import operations
from tests.paths import ROOT


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    path = ROOT / "benchmarks" / "operations.py"
    spec = importlib.util.spec_from_file_location("operations", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# ---- published -----------------------------------------------------------------------------------

PRINTED = [  # formulation, (n, flexible, m), multiplications, additions
    ("book", (6, 6, 2), 25_251, 24_569),
    ("gibbs_appell", (6, 6, 2), 19_557, 18_332),
    ("book", (3, 2, 2), 4_922, 4_851),
    ("gibbs_appell", (3, 2, 2), 2_706, 2_134),
]


@pytest.mark.parametrize(("name", "size", "multiplications", "additions"), PRINTED)
def test_formulas_give_the_printed_numbers(
    bench: ModuleType, name: str, size: tuple[int, int, int], multiplications: int, additions: int
) -> None:
    """Korayem & Shafei (2009), Table 2."""
    found = bench.published(name, bench.Case(*size))
    assert found == {"multiplications": multiplications, "additions": additions}


def test_the_first_printed_case_has_two_modes_and_not_three(bench: ModuleType) -> None:
    """The table prints m = 3; no other small case gives all four numbers."""
    printed = [(name, products, sums) for name, size, products, sums in PRINTED[:2]]
    matches = []
    for n in range(1, 10):
        for flexible in range(1, n + 1):
            for m in range(1, 7):
                case = bench.Case(n, flexible, m)
                if all(
                    bench.published(name, case) == {"multiplications": x, "additions": y}
                    for name, x, y in printed
                ):
                    matches.append((n, flexible, m))
    assert matches == [(6, 6, 2)]
    assert bench.published("gibbs_appell", bench.Case(6, 6, 3))["multiplications"] == 26_508


@pytest.mark.parametrize("size", [(6, 6, 2), (3, 2, 2), (6, 2, 3), (4, 3, 1)])
def test_the_steps_of_table_1_add_up_to_table_2(
    bench: ModuleType, size: tuple[int, int, int]
) -> None:
    whole = bench.PUBLISHED["gibbs_appell"]
    for kind in ("multiplications", "additions"):
        steps = sum(getattr(step, kind)(*size) for step in bench.STEPS)
        assert steps == pytest.approx(getattr(whole, kind)(*size), rel=1e-14)


def test_with_few_flexible_links_the_published_recursion_is_costlier(bench: ModuleType) -> None:
    """In multiplications. Book's text prints 12 009 where its formula gives 11 361."""
    few = bench.Case(6, 2, 3)
    recursion, book = (bench.published(name, few) for name in ("gibbs_appell", "book"))
    assert (recursion["multiplications"], book["multiplications"]) == (13_620, 11_361)
    assert recursion["additions"] < book["additions"]
    assert 12_009 - book["multiplications"] == 18 * few.n**2


# ---- counted -------------------------------------------------------------------------------------


def test_equal_indices_of_different_inputs_are_different_values() -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 2)
    outputs = ca.vertcat(x[0] * x[1] + y[0] * y[1], ca.sin(x[0]) / y[1], x[0] + x[0])
    graph = ca.Function("f", [x, y], [outputs])

    found = operations(graph)

    assert found == {
        "multiplications": 4, "additions": 1, "divisions": 1, "sines and cosines": 1,
    }  # fmt: skip
    assert operations(graph, offline=1) == {
        "multiplications": 2, "additions": 1, "divisions": 1, "sines and cosines": 0,
    }  # fmt: skip


def test_six_links_take_a_fifth_of_the_published_operations(bench: ModuleType) -> None:
    counts = compile_arm(bench.one_shape_per_plane()).operation_count()["mass matrix and bias"]
    assert counts["multiplications"] <= 4_000 < 19_557 / 4
    assert counts["additions"] <= 3_300 < 18_332 / 5


@pytest.mark.parametrize("name", FORMULATIONS)
def test_the_stored_counts_are_reproduced(bench: ModuleType, name: str) -> None:
    """For the small case, general and given; versions of CasADi fold slightly differently."""
    saved = json.loads((ROOT / "docs" / "results" / "operations.json").read_text())
    case = bench.Case(3, 2, 2)
    arm = bench.given_arm(case)
    general, symbols = bench.general_chain(case, "exp")
    for kind, chain, constants in (
        ("general", general, symbols), ("given", compile_arm(arm).chain, []),
    ):  # fmt: skip
        key = {"size": [3, 2, 2], "arm": kind, "formulation": name, "rotation": "exp"}
        (row,) = [row for row in saved["cases"] if key.items() <= row.items()]
        found = bench.count(name, chain, arm.n, arm.n_joint, constants)
        for question, counts in found.items():
            for operation in ("multiplications", "additions", "divisions"):
                expected = row[question][operation]
                assert counts[operation] == pytest.approx(expected, rel=0.02), (kind, question)


def test_no_constant_of_a_general_arm_folds_away(bench: ModuleType) -> None:
    """M and h depend on every entry of every integral of an inner link."""
    case = bench.Case(3, 3, 2)
    chain, _ = bench.general_chain(case, "linear")
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
