"""Every controller of the table on every arm that it takes, and its linear models."""

from typing import Any

import numpy as np
import pytest

from agents.controllers import CONTROLLERS, controller
from agents.controllers.linear_model import LinearModels
from agents.leaderboard.tracks import keywords, takes_part
from agents.metrics import episode_metrics, make_batch, record

IDS = [f"FlexArm/{scene}-Reach-v0" for scene in ("OneLink", "TwoLink")]
SIX = pytest.param("FlexArm/SixLink-Reach-v0", marks=pytest.mark.slow)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("track", ["state", "laboratory"])
@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_every_controller_takes_one_observation_or_a_batch(
    name: str, track: str, env_id: str
) -> None:
    if not takes_part(name, env_id, track):
        pytest.skip("cannot act there")
    envs = make_batch(env_id, 3, keywords(name, track))
    subject = controller(name, envs)
    observations, _ = envs.reset(seed=0)
    state: Any = None
    for _ in range(3):
        actions, state = subject.predict(observations, state, np.zeros(3, bool))
        assert actions.shape == envs.action_space.shape
        assert np.all(np.abs(actions) <= 1.0)
        observations = envs.step(actions.astype(np.float32))[0]
    alone = subject.predict(observations[0])[0]
    assert alone.shape == envs.single_action_space.shape


@pytest.mark.parametrize("env_id", [*IDS, SIX])
def test_a_small_motion_follows_the_linear_model(env_id: str) -> None:
    """The compiled nonlinear step against the matrix exponential."""
    envs = make_batch(env_id, 1, {"integrator": "rk4", "substeps": 200})
    core: Any = envs.unwrapped.core
    models = LinearModels(envs)
    rng = np.random.default_rng(0)
    target = np.array(core.scales.home) + rng.uniform(-0.5, 0.5, core.arm.n_joint)
    model = models.at(target)
    small = 1e-5 * rng.uniform(-1.0, 1.0, (2, core.arm.n))
    q = small[0].copy()
    q[models.joints] += target
    envs.reset(seed=0, options={"state": {"q": q, "v": small[1]}, "target": target})
    x = small.ravel()
    for _ in range(3):
        action = rng.uniform(-1e-5, 1e-5, (1, core.arm.n_joint)).astype(np.float32)
        _, _, _, _, info = envs.step(action)
        x = model.A @ x + model.B @ (action[0] * core.torque_limit)
    found = np.concatenate([core.q[0], core.v[0]])
    found[models.joints] -= target
    scale = np.abs(x).max()
    assert np.abs(found - x).max() < 1e-4 * scale
    readings = model.C @ found
    assert readings[: core.arm.n_joint] == pytest.approx(found[models.joints])
    assert readings[core.arm.n_joint :] == pytest.approx(info["root_curvature"][0], rel=1e-6)


@pytest.mark.parametrize("name", ["pd", "pd-zv", "pd-zvd", "pd-ei", "lqr"])
def test_controllers_settle_the_one_link_arm_without_tuning(name: str) -> None:
    envs = make_batch(IDS[0], 8, keywords(name, "state"))
    gains = {"frequency_ratio": 0.5, "damping_ratio": 1.5, "rise": 0.3}
    ranges = CONTROLLERS[name].ranges
    parameters = CONTROLLERS[name].middle | {k: x for k, x in gains.items() if k in ranges}
    metrics = episode_metrics(record(controller(name, envs, parameters), envs, range(8)))
    assert metrics["success"].mean() == 1.0


def test_lqg_settles_late_and_noisy_readings() -> None:
    envs = make_batch(IDS[0], 8, keywords("lqg", "laboratory"))
    metrics = episode_metrics(record(controller("lqg", envs), envs, range(8)))
    assert metrics["success"].mean() >= 0.75


@pytest.mark.parametrize(("name", "obs"), [("lqr", "sensors"), ("lqg", "state")])
def test_a_controller_names_the_observation_that_it_needs(name: str, obs: str) -> None:
    wanted = CONTROLLERS[name].obs[0]
    with pytest.raises(ValueError, match=f"{name} needs obs='{wanted}'"):
        controller(name, make_batch(IDS[0], 1, {"obs": obs}))
