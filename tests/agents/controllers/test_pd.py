"""Joint PD: the control law, its dimensionless gains, and the search for the best gains."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from agents.controllers import JointPD, controller, joint_pd, tune_pd
from agents.metrics import episode_metrics, make_batch, record

ENV_ID = "FlexArm/OneLink-Reach-v0"


@pytest.fixture(scope="module")
def envs() -> Iterator[Any]:
    envs = make_batch(ENV_ID, 4)
    yield envs
    envs.close()


def test_joint_pd_follows_its_law_within_the_limits() -> None:
    """tau = -K (q - q*) - D (v - v*), over the torque limit, clipped to [-1, 1]."""
    pd = JointPD(
        stiffness=np.array([2.0, 3.0]),
        damping=np.array([0.5, 0.25]),
        torque_limit=np.array([4.0, 1.0]),
        slices={"joint_rate": slice(0, 2), "joint_error": slice(2, 4), "target_rate": slice(4, 6)},
        scales={
            name: np.array([0.1, 0.2]) for name in ("joint_rate", "joint_error", "target_rate")
        },
    )
    observation = np.array([1.0, 2.0, 10.0, 5.0, 3.0, 4.0], np.float32)
    action, _ = pd.predict(observation)
    # joint 1: -(2 * 1.0) - 0.5 * (0.1 - 0.3) = -1.9 of 4;  joint 2: -(3 * 1.0) + 0.1 beyond -1
    np.testing.assert_allclose(action, [-1.9 / 4.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(pd.predict(np.stack([observation] * 3))[0], [action] * 3)


@pytest.mark.parametrize("name", ["pd", "pid", "strain", "ppf", "irc", "zero"])
def test_joint_control_leaves_a_torque_on_the_base_at_zero(name: str) -> None:
    """Actions on an arm whose base nothing turns."""
    driven, free = (
        make_batch("FlexArm/FreeFlyer-Reach-v0", 2, {"obs": "sensors", **keywords})
        for keywords in ({"base_torque": 0.5}, {})
    )
    found, alone = (record(controller(name, envs), envs, [0, 1]) for envs in (driven, free))
    assert found.action.shape[2] == alone.action.shape[2] + 1
    np.testing.assert_allclose(found.action[..., :-1], alone.action, atol=1e-5)
    assert not np.nan_to_num(found.action[..., -1]).any()


def test_dimensionless_gains_give_their_frequency_and_damping(envs: Any) -> None:
    """A rigid joint with the arm's inertia oscillates at ratio x f1 with the damping ratio."""
    model = envs.unwrapped.model
    inertia = model.mass_matrix(np.zeros(model.n))[0, 0]
    first = model.frequencies(np.zeros(model.n), joints="locked")[0]
    pd = joint_pd(envs, 0.5, 0.7)
    frequency = np.sqrt(pd.stiffness[0] / inertia)
    assert frequency == pytest.approx(0.5 * first, rel=1e-12)
    assert pd.damping[0] / (2.0 * inertia * frequency) == pytest.approx(0.7, rel=1e-12)


def test_a_search_in_one_batch_equals_separate_searches(envs: Any) -> None:
    """Every pair of gains in the table has the metrics of a separate run on the same tasks."""
    tuned = tune_pd(
        ENV_ID, frequency_ratios=(0.1, 0.2), damping_ratios=(0.5, 0.8), episodes=4, seed=3
    )
    for row in tuned.table:
        pd = joint_pd(envs, row["frequency_ratio"], row["damping_ratio"])
        metrics = episode_metrics(record(pd, envs, range(3, 7)))
        assert row["tip_error_rms"] == float(np.median(metrics["tip_error_rms"]))
    best = min(tuned.table, key=lambda r: (-r["success_rate"], r["settling_time"]))
    assert tuned.frequency_ratio == best["frequency_ratio"]
