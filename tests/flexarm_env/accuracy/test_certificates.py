"""Certificates: stored, reproducible, and valid for the model and step of the environment."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from dynamics import compile_arm, load_arm, simulate
from dynamics.simulation.case_file import Torque
from flexarm_env import registration
from flexarm_env.accuracy.certificates import RANDOM_STEPS, fit, scene, stored
from flexarm_env.certify import TIME_PER_DECADE, TIP_ERROR, best_first, largest_error, measure

ENV_ID = "FlexArm/OneLink-Reach-v0"
MEASURED = ("error", "integration", "truncation", "nonlinear", "residual")


@pytest.mark.parametrize("env_id", flexarm_env.IDS)
def test_every_environment_has_the_certificate_of_its_own_step(env_id: str) -> None:
    core = gym.make(env_id).unwrapped.core  # type: ignore[attr-defined]
    certificate = core.certificate
    assert certificate["integrator"] == core.integrator
    assert certificate["dt"] == core.control_dt / core.substeps
    assert certificate["reach"] == pytest.approx(core.arm.reach)
    assert certificate["integration"] < 1e-3 * core.arm.reach
    assert certificate["residual"] < certificate["error"]
    assert gym.make(env_id, substeps=50).unwrapped.certificate is None  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "name", ["slim", *(pytest.param(k, marks=pytest.mark.slow) for k in stored() if k != "slim")]
)
def test_measuring_again_gives_the_stored_certificate(name: str) -> None:
    kept = stored()[name]
    best = kept["steps"][0]
    again = measure(name, kept["control_dt"], best["integrator"], best["substeps"]).to_dict()
    assert again.keys() == kept["certificate"].keys()
    for key, value in kept["certificate"].items():
        close = key in MEASURED
        assert again[key] == (pytest.approx(value, rel=1e-3) if close else value), key


@pytest.mark.parametrize(
    "name", ["slim", *(pytest.param(k, marks=pytest.mark.slow) for k in stored() if k != "slim")]
)
def test_the_stored_step_is_accurate_and_one_substep_less_is_not(name: str) -> None:
    entry = stored()[name]
    (length,) = [steps for arm, _, steps in registration.SCENES.values() if arm == name]
    best = entry["steps"][0]
    setting = name, entry["control_dt"], length, best["integrator"]
    assert largest_error(*setting, best["substeps"]) == pytest.approx(best["error"], rel=1e-6)
    assert best["error"] < TIP_ERROR < largest_error(*setting, best["substeps"] - 1)


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
