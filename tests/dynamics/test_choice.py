"""The chosen model is the least that a scene needs, and its claimed error is honest.

Verified against other discretisations followed by another integrator (in tests/reference/, made by
`python benchmarks/model_choice.py --truth`), and against a geometrically nonlinear beam.
"""

import json
import logging
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import eigh

import dynamics.bench
from benchmarks.model_choice import (
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
    Arm,
    Body,
    Choice,
    Joint,
    Link,
    Mode,
    Payload,
    Scene,
    Trajectory,
    ValidityWarning,
    choose_model,
    limits,
    linear,
    load_arm,
    simulate,
)
from dynamics.choice import _roomier
from dynamics.fidelity import Fidelity, everything, rigid, viscous
from dynamics.integrators import INTEGRATORS
from dynamics.model import Model
from dynamics.rollout import Rollout, distance
from dynamics.scene import JointMotion, bang_bang, cycloid, release
from tests.dynamics.random_arms import compiled, two_link_spatial

TRUTH = stored_truth()
NONLINEAR_BEAM = Path(__file__).parents[1] / "reference" / "S1_nonlinear_beam.csv"

# scene -> modes per link and direction, as (least, most); foreshortened?; more segments than one?
NEEDED: dict[str, tuple[list[dict[str, tuple[int, int]]], bool, bool]] = {
    "stiff link": ([{}], False, False),
    "heavy hub": ([{"y": (1, 1)}], False, False),
    "light hub": ([{"y": (2, 3)}], False, False),
    "laboratory arm": ([{"y": (2, 3)}], False, False),
    "stiff and flexible link": ([{}, {"y": (1, 2)}], True, False),
    "fast spin": ([{"y": (1, 2)}], True, False),
    "soft beam": ([{"y": (1, 2)}], True, True),
    "spatial, both joints": ([{"y": (1, 1), "z": (1, 1)}, {}], False, False),
    "spatial, one joint": ([{"y": (1, 1)}, {}], False, False),
    "crank": ([{"x": (1, 1)}, {}], False, False),
}
LEFT_TO_SLOW_RUNS = ("stiff and flexible link", "spatial, one joint", "crank")
SOME_SLOW = [
    pytest.param(name, marks=pytest.mark.slow if name in LEFT_TO_SLOW_RUNS else ())
    for name in NEEDED
]


@cache
def chosen(name: str) -> Choice:
    """One choice per scene and session."""
    trial = TRIALS[name]
    return choose_model(trial.arm, trial.scene, trial.tolerance)


def motion_of(name: str) -> JointMotion:
    return TRIALS[name].scene.motions[0]


@pytest.mark.parametrize("name", NEEDED)
def test_a_scene_gets_what_it_needs_and_no_more(name: str) -> None:
    links, foreshortened, segmented = NEEDED[name]
    arm = chosen(name).arm
    assert arm.foreshortening == foreshortened
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
    own = 7e-6 * S1.reach  # what the beam's solution is good to
    assert apart <= choice.error + choice.residual + own
    assert apart > 0.1 * choice.error  # and the claim is no idle bound


@pytest.mark.parametrize("name", ["heavy hub", "light hub"])
def test_one_mode_less_is_not_enough(name: str) -> None:
    choice, trial = chosen(name), TRIALS[name]
    link = choice.arm.links[0]
    less = replace(link, modes=link.modes[:-1])
    poorer = replace(choice, arm=replace(choice.arm, links=(less, *choice.arm.links[1:])))
    poorer = replace(poorer, integrator="rk4", dt=1e-3)
    assert verified_error(trial, poorer, TRUTH[name]) > trial.tolerance


@pytest.mark.slow
@pytest.mark.parametrize("name", NEEDED)
def test_the_stored_truth_is_what_the_independent_model_does(name: str) -> None:
    tips = independent_tips(TRIALS[name], motion_of(name), truth_times(TRIALS[name]))
    assert distance(tips, TRUTH[name]) <= 0.01 * TRIALS[name].tolerance


def test_a_fast_spin_breaks_the_linear_model() -> None:
    choice = chosen("fast spin")
    linear = replace(
        choice, arm=replace(choice.arm, foreshortening=False), integrator="rk4", dt=0.1
    )
    assert verified_error(TRIALS["fast spin"], linear, TRUTH["fast spin"]) > linear.arm.reach


def test_rungs_say_what_is_wrong_with_them() -> None:
    """One clamped mode on a light free hub is worse than none; rigid is all truncation."""
    ladder = {rung.description: rung for rung in chosen("light hub").ladder}
    assert ladder["link 1: 1 y"].error > ladder["rigid links"].error
    rigid = ladder["rigid links"]
    assert rigid.truncation is not None
    assert rigid.nonlinear is not None
    assert rigid.truncation > 10.0 * rigid.nonlinear
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
def test_a_model_is_named_with_equal_links_together(
    counts: list[Any], segments: list[int], text: str
) -> None:
    assert str(Fidelity(counts=tuple(counts), segments=tuple(segments))) == text


def test_a_choice_is_deterministic_and_tells_what_it_measures(
    caplog: pytest.LogCaptureFixture,
) -> None:
    trial, choice = TRIALS["heavy hub"], chosen("heavy hub")
    caplog.set_level(logging.INFO)
    assert choose_model(trial.arm, trial.scene, trial.tolerance) == choice
    told = dict(m.rsplit(": ", 1) for m in caplog.messages)
    for rung in choice.ladder:
        if rung.integration is None:  # a model, not a step
            assert told[rung.description] == f"{rung.error:.2g} m from the reference"
    assert f"reference, {choice.reference.split(';')[0]}" in told


def test_a_choice_is_json_and_a_table() -> None:
    choice = chosen("heavy hub")
    data = json.loads(json.dumps(chosen("fast spin").to_dict(), allow_nan=False))
    assert load_arm(data["arm"]) == chosen("fast spin").arm
    assert data["ladder"][1]["error"] == "diverged"
    assert choice.table().count("\n") == len(choice.ladder) + 1
    assert choice.reason.endswith("m.")


def test_the_arms_own_modes_name_the_shapes() -> None:
    trial = TRIALS["heavy hub"]
    modes = (Mode(kind="poly", index=1, direction="y"),)
    arm = replace(trial.arm, links=(replace(trial.arm.links[0], modes=modes),))
    choice = choose_model(arm, trial.scene, trial.tolerance)
    assert {mode.kind for mode in choice.arm.links[0].modes} == {"poly"}
    assert len(choice.arm.links[0].modes) == 2


def test_a_reference_that_does_not_converge_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    trial = TRIALS["soft beam"]
    monkeypatch.setattr(dynamics.bench, "REFERENCES", ((2, 2),))
    with pytest.raises(RuntimeError, match=r"does not converge: .*still moves by 0\.\d+ m"):
        choose_model(trial.arm, trial.scene, trial.tolerance)


@pytest.mark.parametrize("beta", [0.0, 0.1])
def test_the_bound_on_eigenvalues_counts_damping(beta: float) -> None:
    """Strong damping, not the fastest mode, then limits explicit steps."""
    arm = two_link_spatial(gravity=(0.0, 0.0, 0.0))
    arm = replace(arm, links=tuple(replace(link, damping_beta=beta) for link in arm.links))
    model = compiled(arm)
    A, _ = model.linearize(np.zeros(model.n), np.zeros(model.n), np.zeros(2))
    largest = np.abs(np.linalg.eigvals(A)).max()
    motion = release((0.0, 0.0), t_end=1.0)
    assert largest <= Rollout(arm).fastest(motion) * (1.0 + 1e-9) < 1.2 * largest


def swinging(t: float) -> np.ndarray:
    return np.array([np.cos(50.0 * t), -0.5])


def steady(t: float) -> np.ndarray:
    return np.array([1.0, -0.5])


SLOW_TO_COMPILE = {"rosenbrock": pytest.mark.slow}


@pytest.mark.parametrize(
    "integrator",
    [pytest.param(name, marks=SLOW_TO_COMPILE.get(name, ())) for name in INTEGRATORS],
)
def test_traced_steps_are_the_compiled_steps(integrator: str) -> None:
    """`simulate` starts an implicit method anew at every step of a torque that varies."""
    method = INTEGRATORS[integrator]
    signal = steady if method.implicit or method.kept(1) else swinging
    arm = chosen("spatial, one joint").arm
    start = {"joint_angles": (0.3, 0.5), "joint_rates": (1.0, -1.0)}
    motion = JointMotion(**start, t_end=0.1, torque=signal)
    model = compiled(arm)
    q, v = np.zeros(model.n), np.zeros(model.n)
    q[list(arm.joint_index)], v[list(arm.joint_index)] = start.values()
    torque = steady(0.0) if signal is steady else signal
    dt = 0.1 / 256
    end = simulate(model, q, v, torque, [0.0, 0.1], integrator=integrator, dt=dt).tip[-1]
    assert_allclose(Rollout(arm).tips(motion, integrator, dt)[-1], end, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"joint_angles": (), "joint_rates": ()}, "joint_angles must hold one angle per joint"),
        ({"joint_rates": (0.0, 0.0)}, "joint_rates must have 1 numbers, got 2"),
        ({"t_end": -1.0}, "t_end must be positive, got -1.0"),
        ({"t_end": float("nan")}, "t_end"),
        ({"torque": 3.0}, "torque must be a function of time or None, got 3.0"),
    ],
)
def test_nonsense_motions_are_refused(change: dict[str, Any], sentence: str) -> None:
    values = {"joint_angles": (0.0,), "joint_rates": (0.0,), "t_end": 1.0}
    with pytest.raises(ValueError, match=sentence):
        JointMotion(**{**values, **change})


def test_a_scene_must_fit_the_arm_and_the_tolerance_be_positive() -> None:
    arm, motion = TRIALS["heavy hub"].arm, motion_of("heavy hub")
    with pytest.raises(ValueError, match="at least one motion"):
        Scene(motions=())
    with pytest.raises(ValueError, match=r"joint_angles must have shape \(1,\).*got \(2,\)"):
        choose_model(arm, Scene(motions=(release((0.0, 0.0), t_end=1.0),)), 1e-3)
    odd = replace(motion, torque=lambda t: [0.0, 0.0])
    with pytest.raises(ValueError, match=r"torque must have shape \(1,\).*got \(2,\)"):
        choose_model(arm, Scene(motions=(odd,)), 1e-3)
    with pytest.raises(ValueError, match=r"tolerance must be positive, got 0\.0"):
        choose_model(arm, Scene(motions=(motion,)), 0.0)


DAMPED = Link(
    length=0.9, rho_A=0.3, EIz=12.0, EIy=20.0, tip_mass=0.2, damping_ratio=0.03,
    modes=(Mode(kind="clamped-free", index=1, direction="y"),),
)  # fmt: skip


def held_decay(arm: Arm) -> float:
    """[-] damping ratio of the slowest mode with the joint held, from the linear matrices."""
    chain = Model(arm).chain
    M, K, C = linear.inertia(chain, np.zeros(arm.n)), linear.stiffness(chain), linear.damping(chain)
    squares, S = eigh(K[1:, 1:], M[1:, 1:])
    return float(S[:, 0] @ C[1:, 1:] @ S[:, 0] / (2.0 * np.sqrt(squares[0])))


def limits_at_rest(arm: Arm) -> tuple[str, ...]:
    still = np.zeros((1, arm.n))
    return limits(Model(arm), Trajectory(np.zeros(1), still, still, np.zeros((1, 3))))


@pytest.mark.parametrize("payload", [None, Payload(mass=0.5)])
@pytest.mark.parametrize(("segments", "polynomial"), [(1, False), (1, True), (4, True)])
def test_every_model_damps_a_first_mode_by_the_described_ratio(
    payload: Payload | None, segments: int, polynomial: bool
) -> None:
    """Shapes and segments are how a link is modelled, damping is what it is."""
    arm = Arm(links=(DAMPED,), payload=payload)
    model = Fidelity(counts=((3, 0, 0),), segments=(segments,), polynomial=polynomial)
    assert held_decay(model.arm(arm)) == pytest.approx(0.03, rel=2e-3)
    if segments > 1:
        cut = replace(arm, links=(replace(DAMPED, segments=segments),))
        assert held_decay(cut) < 0.2 * 0.03
        (sentence,) = limits_at_rest(cut)
        beta = model.arm(arm).links[0].damping_beta
        assert f"set damping_beta={beta:.3g} instead" in sentence
        assert limits_at_rest(model.arm(arm)) == ()


def test_viscosity_goes_by_the_slowest_direction_and_only_where_there_is_a_ratio() -> None:
    both, stiff = viscous(DAMPED), viscous(replace(DAMPED, EIz=0.0, modes=()))
    assert both.damping_beta == pytest.approx(stiff.damping_beta * np.sqrt(20.0 / 12.0), rel=1e-9)
    assert both.damping_ratio == stiff.damping_ratio == 0.0
    spun = Body(mass=1.0, inertia=tuple(map(tuple, np.eye(3))))
    body = Link(length=0.9, body=spun, EIz=12.0, damping_ratio=0.03)
    rigid = replace(DAMPED, EIz=0.0, EIy=0.0, modes=())
    for link in (replace(DAMPED, damping_ratio=0.0), rigid, body):
        assert viscous(link) is link
    assert everything(Arm(links=(DAMPED, body)), 2, 1) == ((2, 2, 0), (0, 0, 0))


def test_a_damped_arm_gets_no_richer_model_than_an_undamped_one() -> None:
    trial, bare = TRIALS["laboratory arm"], chosen("laboratory arm").arm.links[0]
    arm = replace(trial.arm, links=(replace(trial.arm.links[0], damping_ratio=0.02),))
    (link,) = choose_model(arm, trial.scene, trial.tolerance).arm.links
    assert (len(link.modes), link.segments) <= (len(bare.modes), bare.segments)
    assert link == replace(viscous(arm.links[0]), modes=link.modes)


def test_typical_motions() -> None:
    pulse = bang_bang((2.0, 0.5), pulse=0.2, t_end=1.0)
    assert pulse.knots == (0.0, 0.2, 0.4, 1.0)
    assert pulse.torque is not None
    assert_allclose([pulse.torque(t) for t in (0.1, 0.3, 0.5)], [[2, 0.5], [-2, -0.5], [0, 0]])
    smooth = cycloid((2.0,), duration=0.4, t_end=1.0)
    assert smooth.torque is not None
    assert_allclose([smooth.torque(t)[0] for t in (0.1, 0.3, 0.4)], [2.0, -2.0, 0.0], atol=1e-12)
    assert release((0.1,), t_end=1.0).torque is None


def test_limits_name_every_assumption_that_a_motion_leaves() -> None:
    mode = Mode(kind="clamped-free", index=1, direction="y")
    link = replace(S1.links[0], modes=(mode,), joint=Joint(rotor_inertia=0.01))
    model = compiled(replace(S1, links=(link,)))
    first = model.frequencies()[0]

    def moved(rate: float, tip: float) -> Trajectory:
        q, v = np.array([[0.0, 0.0], [0.1, tip]]), np.array([[0.0, 0.0], [rate, 0.0]])
        return Trajectory(np.array([0.0, 1.0]), q, v, np.zeros((2, 3)))

    length = link.length
    assert limits(model, moved(0.49 * first, 0.09 * length)) == ()
    (rate,) = limits(model, moved(-0.51 * first, 0.0))
    assert "Joint 1 turns" in rate
    (bent,) = limits(model, moved(0.0, -0.105 * length))
    assert "Link 1 bends by up to 10% of its link's length" in bent
    assert "tip by up to 0.21 rad" in limits(model, moved(0.0, 0.15 * length))[1]
    stiffening = compiled(replace(model.arm, foreshortening=True))
    assert limits(stiffening, moved(2.0 * first, 0.0)) == ()
    with pytest.warns(ValidityWarning, match="Joint 1 turns"):
        simulate(model, [0.0, 0.0], [0.51 * first, 0.0], None, [0.0, 1e-3])


@pytest.mark.parametrize(("error", "expected"), [(0.65, None), (0.75, 2), (0.85, 3)])
def test_a_model_that_crowds_its_steps_gets_a_roomier_rival(
    error: float, expected: int | None
) -> None:
    """The cheapest that leaves twice as much: 0.25 wants more than 0.5 left, 0.15 more than 0.3."""
    arm, errors = ARMS["deluca-siciliano"], {2: 0.45, 3: 0.6}
    one = replace(rigid(arm, polynomial=True), counts=((1, 0, 0), (1, 0, 0)))

    def left(model: Fidelity) -> float:
        return 1.0 - (error if model == one else errors[2 if model.counts[0][0] == 2 else 3])

    def operations(model: Fidelity) -> int:
        return 2 if model.counts[0][0] == 2 else 1  # the second link's further mode is cheaper

    bench: Any = SimpleNamespace(tolerance=1.0, arm=arm, left=left, operations=operations)
    rival = _roomier(bench, one)
    if expected is None:
        assert rival is None
    else:
        assert rival is not None
        assert rival.counts == (((2, 0, 0), (1, 0, 0)) if expected == 2 else ((1, 0, 0), (2, 0, 0)))
