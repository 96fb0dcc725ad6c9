"""Certificates: stored, reproducible, and valid for the model and step of the environment."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from dynamics import Mode, choose_model, compile_arm, load_arm, simulate
from dynamics.accuracy.fidelity import everything, rigid
from dynamics.accuracy.model_choice import STEP_RATIO
from dynamics.accuracy.scene import JointMotion
from dynamics.simulation.case_file import Torque
from flexarm_env.accuracy.certificates import fit, scene, stored
from flexarm_env.accuracy.episodes import EPISODE_ERROR, RANDOM_STEPS, episode_error, keeps_tip
from flexarm_env.certify import (
    ACCURACY,
    TIME_PER_DECADE,
    TIP_ERROR,
    best_first,
    certifier_of,
    fewest_steps,
)
from flexarm_env.core import Core

ENV_ID = "FlexArm/OneLink-Reach-v0"
SIX_LINKS = pytest.param("six-link", marks=pytest.mark.slow)
ARMS = ["slim", "two-link", "free-flyer", SIX_LINKS]
USUAL = [env_id for env_id in flexarm_env.IDS if "Agile" not in env_id]
AGILE = sorted(set(flexarm_env.IDS) - set(USUAL))
MEASURED = ("error", "integration", "truncation", "nonlinear", "residual")


@pytest.mark.parametrize("env_id", AGILE)
def test_no_certificate_holds_above_the_torques_that_were_measured(env_id: str) -> None:
    base = gym.make(env_id).unwrapped
    usual = gym.make(env_id.replace("ReachAgile", "Reach")).unwrapped
    assert base.certificate is None  # type: ignore[attr-defined]
    limits = usual.torque_limit.tolist()  # type: ignore[attr-defined]
    assert f"above {limits[0]:g}" in base.uncertified  # type: ignore[attr-defined]
    weaker = gym.make(env_id, torque_limit=limits).unwrapped
    assert weaker.certificate == usual.certificate  # type: ignore[attr-defined]


@pytest.mark.parametrize("env_id", USUAL)
def test_every_environment_has_the_certificate_of_its_own_step(env_id: str) -> None:
    core = gym.make(env_id).unwrapped.core  # type: ignore[attr-defined]
    certificate = core.certificate
    assert certificate["integrator"] == core.integrator
    assert certificate["dt"] == core.control_dt / core.substeps
    assert certificate["reach"] == pytest.approx(core.arm.reach)
    error, residual, reach = certificate["error"], certificate["residual"], core.arm.reach
    assert error + residual <= TIP_ERROR * reach
    assert residual < max(error, ACCURACY * reach)
    assert gym.make(env_id, substeps=50).unwrapped.certificate is None  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ARMS)
def test_measuring_again_gives_the_stored_certificate_and_steps(name: str) -> None:
    kept = stored()[name]
    best, dt = kept["steps"][0], kept["control_dt"]
    chosen = best["integrator"], best["substeps"]
    certifier = certifier_of(name, dt)

    again = certifier.certificate(chosen[0], dt / chosen[1]).to_dict()
    step = fewest_steps(certifier, dt, chosen[0])

    assert again.keys() == kept["certificate"].keys()
    for key, value in kept["certificate"].items():
        close = key in MEASURED
        assert again[key] == (pytest.approx(value, rel=1e-3) if close else value), key
    assert step is not None
    assert step["substeps"] == best["substeps"]
    assert step["error"] == pytest.approx(best["error"], rel=1e-3)
    assert episode_error(name, dt, *chosen) == pytest.approx(best["episode_error"], rel=1e-6)
    assert best["episode_error"] <= EPISODE_ERROR


@pytest.mark.parametrize("name", ARMS)
def test_a_registered_arm_is_what_choose_model_finds(name: str) -> None:
    """Model, integrator and step; the step also keeps the tip in episodes.

    `choose_model` brackets a step to a ratio of STEP_RATIO; `certify` counts to the fewest.
    """
    arm, kept = load_arm(name), stored()[name]
    dt, best = kept["control_dt"], kept["steps"][0]

    keeps = partial(keeps_tip, dt)
    choice = choose_model(arm, scene(arm, dt), TIP_ERROR * arm.reach, acceptable=keeps)

    found = [(link.modes, link.segments, link.lumped) for link in choice.arm.links]
    assert found == [(link.modes, link.segments, link.lumped) for link in arm.links]
    assert choice.arm.foreshortening == arm.foreshortening
    assert choice.integrator == best["integrator"]
    assert best["substeps"] <= round(dt / choice.dt) <= STEP_RATIO * best["substeps"]


@pytest.mark.parametrize("name", ARMS)
def test_a_second_path_measures_the_same_error(name: str) -> None:
    """Other segments with powers of x, SciPy's error control, and the compiled environment."""
    arm, kept = load_arm(name), stored()[name]
    dt, error = kept["control_dt"], kept["certificate"]["error"]
    modes, parts = (3, 5) if arm.n_joint <= 2 else (2, 3)
    fine = rigid(arm, foreshortening=True, polynomial=True)
    fine = replace(fine, counts=everything(arm, modes, 1), segments=(parts,) * arm.n_joint)
    links = tuple(replace(link, modes=powers(link.modes)) for link in fine.arm(arm).links)
    model = compile_arm(replace(fine.arm(arm), links=links))

    found = 0.0
    for motion in scene(arm, dt).motions:
        assert isinstance(motion.torque, Torque)
        assert motion.hold
        steps = round(motion.t_end / motion.hold)
        times = motion.hold * np.arange(steps + 1)
        rest = np.zeros(model.n)
        q = model.rigid(rest)
        q[list(model.arm.joint_index)] = motion.joint_angles
        truth = simulate(model, q, rest, motion.torque, times, rtol=1e-7).tip
        found = max(found, float(np.linalg.norm(stepped_tips(name, motion) - truth, axis=1).max()))

    assert found == pytest.approx(error, rel=0.2)


def powers(modes: tuple[Mode, ...]) -> tuple[Mode, ...]:
    """Modes of the same directions and indices with powers of x as shapes."""
    return tuple(Mode(kind="poly", index=m.index, direction=m.direction) for m in modes)


def stepped_tips(name: str, motion: JointMotion) -> np.ndarray:
    """(steps + 1, 3) [m] tips of an arm's environment under a motion's torques."""
    core = Core(task="Reach", arm=name, control_dt=stored()[name]["control_dt"], n_env=1)
    core.seed(0, np.random.default_rng(0))
    q = np.zeros(core.arm.n)
    q[list(core.arm.joint_index)] = motion.joint_angles
    core.reset(np.arange(1), {"state": {"q": q}})
    assert isinstance(motion.torque, Torque)
    assert motion.hold
    tips = [core.model.tip(core.q[0])]
    for k in range(round(motion.t_end / motion.hold)):
        torque = np.array(motion.torque((k + 0.5) * motion.hold)) / core.torque_limit
        core.step(torque[None].astype(np.float32))
        tips.append(core.model.tip(core.q[0]))
    return np.array(tips)


def test_a_tenth_of_the_error_may_cost_a_tenth_more_time() -> None:
    fast = {"seconds": 1.0, "error": 1e-3}
    accurate = {"seconds": 0.99 * math.exp(2.0 * TIME_PER_DECADE), "error": 1e-5}
    slow = {"seconds": 1.01 * math.exp(2.0 * TIME_PER_DECADE), "error": 1e-5}
    assert best_first([slow, fast, accurate]) == [accurate, fast, slow]


def random_torque_tips(**keywords: Any) -> np.ndarray:
    """(steps, 3) [m] tips of the one-link environment under the random torques of its scene."""
    env: Any = gym.make(ENV_ID, **keywords).unwrapped
    _, signals = (motion.torque.signals for motion in scene(load_arm("slim"), 0.02).motions)
    env.reset(seed=0, options={"state": {}, "target": [0.0]})
    tips = []
    for torque in signals[0].values:
        env.step(np.array([torque / env.torque_limit[0]], np.float32))
        tips.append(env.core.model.tip(env.core.q[0]))
    return np.array(tips)


@pytest.mark.parametrize("keywords", [{}, {"tolerance": 0.012}, {"fidelity": "rigid"}])
def test_the_claimed_error_holds_against_another_model_and_step(
    keywords: dict[str, Any],
) -> None:
    """A finer model in steps of 0.1 ms, on one of the certified motions."""
    env: Any = gym.make(ENV_ID, **keywords).unwrapped
    arm = load_arm("slim")
    fine = compile_arm(fit(arm, 0.02, "reference", None).arm)
    motion = scene(arm, 0.02).motions[1]
    assert isinstance(motion.torque, Torque)
    times = 0.02 * np.arange(RANDOM_STEPS + 1)
    rest = np.zeros(fine.n)
    truth = simulate(fine, rest, rest, motion.torque, times, integrator="midpoint", dt=1e-4).tip[1:]
    error = np.linalg.norm(random_torque_tips(**keywords) - truth, axis=1).max()
    if "fidelity" in keywords:
        assert error > 0.005  # a rigid arm is worse than either
    else:
        assert error < env.certificate["error"]
    if "tolerance" in keywords:
        assert env.certificate["error"] <= keywords["tolerance"]


def test_fidelity_changes_the_model_and_not_the_task() -> None:
    rigid, auto, fine = (
        gym.make(ENV_ID, fidelity=name).unwrapped for name in ("rigid", "auto", "reference")
    )
    assert [env.core.arm.n for env in (rigid, auto, fine)] == [1, 3, 7]  # type: ignore[attr-defined]
    for env in (rigid, fine):
        assert env.torque_limit == auto.torque_limit  # type: ignore[attr-defined]
        assert env.certificate is None  # type: ignore[attr-defined]
    for bad, words in (
        ({"fidelity": "best"}, r"Unknown fidelity 'best'. Known"),
        ({"fidelity": "rigid", "tolerance": 0.1}, "not both"),
        ({"tolerance": -1.0}, "tolerance must be positive"),
    ):
        with pytest.raises(ValueError, match=words):
            gym.make(ENV_ID, **bad)  # type: ignore[arg-type]
