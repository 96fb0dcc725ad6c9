"""`choose_model` returns the least model that a scene needs, and its claimed error holds.

The claims are verified against other discretisations under another integrator (tests/reference/,
made by `python -m benchmarks.accuracy.model_choice --truth`) and against a geometrically nonlinear
beam.
"""

import json
import logging
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.accuracy.model_choice import (
    S1,
    TRIALS,
    chosen_tips,
    independent_tips,
    stored_truth,
    truth_times,
    verified_error,
)
from dynamics import (
    ARMS,
    Choice,
    Mode,
    choose_model,
    load_arm,
)
from dynamics.accuracy import reference
from dynamics.accuracy.fidelity import Fidelity, rigid
from dynamics.accuracy.model_choice import _rival
from dynamics.accuracy.rollout import distance
from dynamics.accuracy.scene import JointMotion
from tests.paths import REFERENCE

TRUTH = stored_truth()
NONLINEAR_BEAM = REFERENCE / "S1_nonlinear_beam.csv"

# scene -> modes per link and direction, as (least, most); foreshortened?; segmented?
NEEDED: dict[str, tuple[list[dict[str, tuple[int, int]]], bool, bool]] = {
    "stiff link": ([{}], False, False),
    "heavy hub": ([{"y": (1, 1)}], False, False),
    "light hub": ([{"y": (2, 3)}], False, False),
    "laboratory arm": ([{"y": (2, 3)}], False, False),
    "stiff and flexible link": ([{}, {"y": (1, 2)}], True, False),
    "fast spin": ([{"y": (1, 2)}], True, False),
    "soft beam": ([{"y": (1, 2)}], True, True),
    "spatial, both joints": ([{"y": (1, 2), "z": (1, 1)}, {}], False, False),
    "spatial, one joint": ([{"y": (1, 1)}, {"z": (0, 1)}], False, False),  # 1: for longer steps
    "crank": ([{"x": (1, 1)}, {}], False, False),
}
LEFT_TO_SLOW_RUNS = ("stiff and flexible link", "spatial, one joint")
SOME_SLOW = [
    pytest.param(name, marks=[pytest.mark.slow] if name in LEFT_TO_SLOW_RUNS else [])
    for name in NEEDED
]


@cache
def chosen(name: str) -> Choice:
    """Choice for a scene, made once per session."""
    trial = TRIALS[name]
    return choose_model(trial.arm, trial.scene, trial.tolerance)


def motion_of(name: str) -> JointMotion:
    return TRIALS[name].scene.motions[0]


@pytest.mark.parametrize("name", NEEDED)
def test_the_choice_for_a_scene_has_the_modes_that_it_needs_and_no_more(name: str) -> None:
    links, foreshortened, segmented = NEEDED[name]
    arm = chosen(name).arm
    assert bool(arm.foreshortening) == foreshortened
    assert any(link.segments > 1 for link in arm.links) == segmented
    for link, wanted in zip(arm.links, links, strict=True):
        for direction in "xyz":
            least, most = wanted.get(direction, (0, 0))
            assert least <= len(link.in_direction(direction)) <= most


@pytest.mark.parametrize("name", SOME_SLOW)
def test_the_compiled_choice_is_as_good_as_claimed(name: str) -> None:
    choice, trial = chosen(name), TRIALS[name]
    verified = verified_error(trial, choice, TRUTH[name])
    assert verified <= choice.error + choice.residual <= trial.tolerance


def test_the_claim_holds_against_a_beam_without_assumed_modes() -> None:
    choice = chosen("laboratory arm")
    truth = np.loadtxt(NONLINEAR_BEAM, delimiter=",", skiprows=3)[::4]
    tips = chosen_tips(choice, motion_of("laboratory arm"), truth[:, 0])
    apart = np.linalg.norm(tips[:, :2] - truth[:, 1:3], axis=1).max()
    uncertainty = 7e-6 * S1.reach  # of the beam's solution
    assert apart <= choice.error + choice.residual + uncertainty
    assert apart > 0.1 * choice.error  # the claim is not much too large either


@pytest.mark.parametrize("name", ["heavy hub", "light hub"])
def test_the_choice_with_one_mode_less_exceeds_the_tolerance(name: str) -> None:
    choice, trial = chosen(name), TRIALS[name]
    link = choice.arm.links[0]
    less = replace(link, modes=link.modes[:-1])
    reduced = replace(choice, arm=replace(choice.arm, links=(less, *choice.arm.links[1:])))
    reduced = replace(reduced, integrator="rk4", dt=1e-3)
    assert verified_error(trial, reduced, TRUTH[name]) > trial.tolerance


@pytest.mark.slow
@pytest.mark.parametrize("name", NEEDED)
def test_the_stored_truth_is_the_motion_of_the_independent_model(name: str) -> None:
    tips = independent_tips(TRIALS[name], motion_of(name), truth_times(TRIALS[name]))
    assert distance(tips, TRUTH[name]) <= 0.01 * TRIALS[name].tolerance


def test_a_fast_spin_breaks_the_linear_model() -> None:
    choice = chosen("fast spin")
    linearized = replace(
        choice, arm=replace(choice.arm, foreshortening=False), integrator="rk4", dt=0.1
    )
    assert (
        verified_error(TRIALS["fast spin"], linearized, TRUTH["fast spin"]) > linearized.arm.reach
    )


def test_the_ladder_separates_truncation_from_nonlinearity() -> None:
    """One clamped mode on a light free hub errs more than none; rigid links err by truncation."""
    trial, (first, *_) = TRIALS["light hub"], chosen("light hub").ladder
    errors = reference.ModelErrors(trial.arm, trial.scene, trial.tolerance)
    errors.converge()
    clamped = replace(rigid(trial.arm), counts=((1, 0, 0),))
    assert errors.error(clamped) > errors.error(rigid(trial.arm)) == first.error
    assert first.truncation is not None
    assert first.nonlinear is not None
    assert first.truncation > 10.0 * first.nonlinear
    assert chosen("fast spin").ladder[0].nonlinear == np.inf


@pytest.mark.parametrize(
    ("counts", "segments", "text"),
    [
        ([(0, 0, 0)] * 2, [1, 1], "rigid links"),
        ([(2, 0, 0)], [1], "link 1: 2 y"),
        ([(1, 1, 0)] * 3, [1, 1, 1], "links 1 to 3: 1 y + 1 z"),
        ([(1, 0, 0)] * 2, [1, 2], "link 1: 1 y; link 2: 2 x (1 y)"),
        (
            [(1, 0, 0), (0, 0, 1), *3 * [(1, 0, 0)], (0, 0, 0), (1, 0, 0), (1, 0, 0)],
            [1] * 8,
            "links 1, 3 to 5, 7, 8: 1 y; link 2: 1 x; link 6: rigid",
        ),
    ],
)
def test_the_name_of_a_model_groups_equal_links(
    counts: list[Any], segments: list[int], text: str
) -> None:
    assert str(Fidelity(counts=tuple(counts), segments=tuple(segments))) == text


def test_a_choice_is_deterministic_and_logs_every_measurement(
    caplog: pytest.LogCaptureFixture,
) -> None:
    trial, choice = TRIALS["heavy hub"], chosen("heavy hub")
    caplog.set_level(logging.INFO)
    assert choose_model(trial.arm, trial.scene, trial.tolerance) == choice
    logged = dict(m.rsplit(": ", 1) for m in caplog.messages)
    for rung in choice.ladder:
        if rung.integration is None:  # a model, not a step
            assert logged[rung.description] == f"{rung.error:.2g} m from the reference"
    assert f"reference, {choice.reference.split(';')[0]}" in logged


def test_a_choice_converts_to_json_and_to_a_table() -> None:
    choice = chosen("heavy hub")
    data = json.loads(json.dumps(chosen("fast spin").to_dict(), allow_nan=False))
    assert load_arm(data["arm"]) == chosen("fast spin").arm
    assert data["ladder"][1]["error"] == "diverged"
    assert choice.table().count("\n") == len(choice.ladder) + 1
    assert choice.reason.endswith("m.")


def test_the_arms_own_modes_select_the_family_of_shapes() -> None:
    """On a light hub, where two natural shapes are as good as four polynomials."""
    trial = TRIALS["light hub"]
    modes = (Mode(kind="clamped-free", index=1, direction="y"),)
    arm = replace(trial.arm, links=(replace(trial.arm.links[0], modes=modes),))
    choice = choose_model(arm, trial.scene, trial.tolerance)
    assert {mode.kind for mode in choice.arm.links[0].modes} == {"clamped-free"}


def test_a_reference_that_does_not_converge_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = TRIALS["soft beam"]
    monkeypatch.setattr(reference, "REFERENCES", ((2, 2),))
    with pytest.raises(RuntimeError, match=r"does not converge: .*still moves by 0\.\d+ m"):
        choose_model(trial.arm, trial.scene, trial.tolerance)


def test_a_damped_arm_gets_no_larger_model_than_an_undamped_one() -> None:
    trial, bare = TRIALS["laboratory arm"], chosen("laboratory arm").arm.links[0]
    arm = replace(trial.arm, links=(replace(trial.arm.links[0], damping_ratio=0.02),))
    (link,) = choose_model(arm, trial.scene, trial.tolerance).arm.links
    assert (len(link.modes), link.segments) <= (len(bare.modes), bare.segments)
    assert link == replace(arm.links[0], modes=link.modes)


@pytest.mark.parametrize(("error", "expected"), [(0.65, None), (0.75, 2), (0.85, 3)])
def test_a_model_with_a_small_step_budget_gets_a_rival_with_twice_that_budget(
    error: float, expected: int | None
) -> None:
    """The cheapest such: a budget of 0.25 asks for more than 0.5, one of 0.15 for more than 0.3."""
    arm, errors = ARMS["deluca-siciliano"], {2: 0.45, 3: 0.6}
    one = replace(rigid(arm, polynomial=True), counts=((1, 0, 0), (1, 0, 0)))

    def step_budget(model: Fidelity) -> float:
        return 1.0 - (error if model == one else errors[2 if model.counts[0][0] == 2 else 3])

    def operations(model: Fidelity) -> int:
        return 2 if model.counts[0][0] == 2 else 1  # the second link's further mode is cheaper

    measured: Any = SimpleNamespace(
        tolerance=1.0, arm=arm, step_budget=step_budget, operations=operations
    )
    rival = _rival(measured, one)
    if expected is None:
        assert rival is None
    else:
        assert rival is not None
        assert rival.counts == (((2, 0, 0), (1, 0, 0)) if expected == 2 else ((1, 0, 0), (2, 0, 0)))
