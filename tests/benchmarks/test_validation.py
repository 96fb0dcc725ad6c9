"""Validation: the stored verdicts are reproduced, and verdicts follow from comparisons."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.validation import __main__ as validation
from benchmarks.validation import counts as validation_counts
from benchmarks.validation import large_arms as validation_large_arms
from benchmarks.validation import pd as validation_pd
from benchmarks.validation import slim as validation_slim
from benchmarks.validation.entries import Number, Table, as_printed
from benchmarks.validation.page import HONESTY, page
from benchmarks.validation.pd import STEPS, Step
from dynamics import compile_arm
from dynamics.arms.measures import alone, hertz


@pytest.fixture(scope="module")
def stored() -> dict[str, Any]:
    return json.loads(validation.data_of(validation.PAGE).read_text(encoding="utf-8"))


def test_every_verdict_of_the_short_form_equals_the_stored_one(stored: dict[str, Any]) -> None:
    """After an intended change, run `python -m benchmarks.validation`."""
    known = validation.verdicts(stored["tables"], quick=True)
    assert len(known) > 300
    assert validation.changed(validation.verdicts(validation.run(quick=True)), known) == []


def test_the_committed_page_is_that_of_the_data(stored: dict[str, Any]) -> None:
    text = validation.PAGE.read_text(encoding="utf-8")
    assert text == page(stored) + "\n"
    for link in ("results/validation.json", "validation_slim_step.png"):
        assert link in text
    for picture in validation.PAGE.parent.joinpath("results").glob("validation_*.png"):
        assert picture.name in text


def test_every_claimed_number_is_reproduced(stored: dict[str, Any]) -> None:
    found = validation.verdicts(stored["tables"])
    assert "not reproduced" not in found.values()
    assert {kind for _, _, kind, _ in HONESTY} <= set(found.values())


def test_a_number_is_judged_by_its_distance() -> None:
    (row,) = as_printed(("f",), "2.096", "Hz")
    assert row.verdict(2.0964) == "reproduced"
    assert row.verdict(2.0966) == "not reproduced"
    assert row.verdict(float("nan")) == "not reproduced"


def test_an_error_in_print_must_miss_the_print_and_meet_the_correction() -> None:
    row = Number(quantity="f", printed="41.524", within=0.05, correct=40.524)
    assert row.verdict(40.52) == "error in print"
    assert row.verdict(41.52) == "not reproduced"
    assert row.verdict(39.52) == "not reproduced"
    assert replace(row, within=2.0).verdict(40.52) == "not reproduced"  # tells nothing


def test_a_table_refuses_results_that_do_not_fit_its_numbers() -> None:
    table = Table(
        chapter="c", title="t", rows=as_printed(("a", "b"), "1 2"), ours=lambda: [1.0], demand="d"
    )
    with pytest.raises(ValueError, match="t: 2 numbers but 1 results"):
        table.results()


def test_a_changed_verdict_is_named() -> None:
    assert validation.changed({"a": "x", "b": "y"}, {"a": "x", "b": "z", "c": "y"}) == [
        "b: z -> y",
        "c: y -> gone",
    ]


def test_our_own_counts_are_included_if_they_are_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = json.loads(validation_counts.COUNTED.read_text())
    (six,) = [
        case["M and h"]
        for case in found["cases"]
        if (case["size"], case["arm"]) == ([6, 6, 2], "general")
        and (case["formulation"], case["rotation"]) == ("gibbs_appell", "linear")
    ]
    (table,) = validation_counts.counted()
    rows = {row["quantity"]: row for row in table.results()}
    row = rows["gibbs_appell, (6, 6, 2), additions"]
    assert (row["theirs"], row["verdict"]) == ("18332", "not comparable")
    assert row["ours"] == six["additions"]
    assert "the preset six-link, folded, multiplications" in rows

    monkeypatch.setattr(validation_counts, "COUNTED", tmp_path / "operations.json")
    assert validation_counts.counted() == []


# ---- the arm like RALF on its actuators' springs -------------------------------------------------


def test_stiff_springs_lock_the_joints_and_soft_ones_carry_rigid_links() -> None:
    """With soft springs the links move as rigid bodies; a right elbow uncouples them."""
    large = validation_large_arms
    locked = hertz(large.finer(), angles=large.ELBOW)
    m, L = 31.75 / 2.0, 3.048
    inertia = np.array([m * L**2 / 3.0 + m * L**2, m * L**2 / 3.0])

    assert large.on_springs(1e3)[:4] == pytest.approx(locked[:4], rel=1e-5)
    rigid = np.sqrt(np.array(large.SPRINGS) * 0.01**2 / inertia) / (2.0 * np.pi)
    assert large.on_springs(0.01)[:2] == pytest.approx(rigid, rel=1e-3)


# ---- joint PD control ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", STEPS)
def test_V_falls_by_the_work_of_the_joint_damping(name: str) -> None:
    """V is computed from M and K, the work from the joint rates of the motion."""
    fault, rise = validation_pd.balance(STEPS[name])
    assert fault < 1e-8
    assert rise < 1e-10
    response = validation_pd.respond(STEPS[name])
    assert response.V[-1] < 0.05 * response.V[0]


def test_V_is_constant_without_joint_damping_and_falls_faster_with_damped_links() -> None:
    """The balance is not a tautology: it changes if the theorem's assumptions fail."""
    step = STEPS["slim"]
    free = validation_pd.respond(replace(step, K_D=(0.0,)), 0.3)
    assert_allclose(free.V, free.V[0], rtol=1e-9)
    links = tuple(replace(link, damping_ratio=0.05) for link in step.arm.links)
    damped = validation_pd.respond(replace(step, arm=replace(step.arm, links=links)), 0.3)
    assert np.min(damped.V + damped.spent) < 0.999 * damped.V[0]


def test_under_gravity_V_without_gravity_may_rise() -> None:
    """The proof needs g = 0: the arm hanging from its joint sags past its target."""
    step = STEPS["slim"]
    hung = Step(
        title="hung", arm=replace(step.arm, gravity=(0.0, -9.81, 0.0)), target=(0.0,),
        K_P=step.K_P, K_D=step.K_D,
    )  # fmt: skip
    response = validation_pd.respond(hung, 0.3)
    model = compile_arm(hung.arm)
    gravity = [model.energy(q, v)[2] for q, v in zip(response.q, response.v, strict=True)]
    without = response.V - np.array(gravity)
    assert np.diff(without).max() > 1e-4
    assert np.abs(response.V + response.spent - response.V[0]).max() < 1e-9  # with it, a balance


def test_strains_under_a_static_tip_load_are_proportional_to_the_lever() -> None:
    """The strain at mid-length is half of that at the root."""
    model = compile_arm(alone(validation_slim.SLIM, 0, 2, "poly"))
    delta = np.linalg.solve(model.stiffness[1:, 1:], np.ones(2))
    base, middle = validation_pd.strains(model, np.array([[0.0, *delta]]))[0]
    assert middle == pytest.approx(0.5 * base, rel=1e-10)
    assert base > 0.0


def test_a_gain_takes_the_joint_from_free_to_locked() -> None:
    """Both frequencies rise with the gain, from 0 to 2.096 Hz and from 7.446 to 13.989 Hz."""
    found = validation_pd.stiffened(np.geomspace(1e-6, 1e6, 9).tolist())
    assert np.all(np.diff(found, axis=0) > 0.0)
    assert found[-1] == pytest.approx([2.096, 13.989], rel=1e-3)
    assert found[0, 1] == pytest.approx(validation_slim.on_hub(0.01, 2)[0], rel=1e-6)
