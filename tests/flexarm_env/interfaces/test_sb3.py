"""Batches of stable-baselines3 whose observations have a part for the critic."""

from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.monitor import Monitor

from flexarm_env import SB3VecEnv, TorchVecEnv

N, STEPS = 6, 9
ENV_ID = "FlexArm/OneLink-Reach-v0"
SHORT: dict[str, Any] = {"hardware": "laboratory", "max_episode_steps": STEPS}
CLOSE: dict[str, float] = {"rtol": 1e-6, "atol": 1e-6}  # float32


def test_a_critic_sees_what_it_sees_of_the_batch_of_tensors() -> None:
    """Over ends of episodes, whose last observations are of the state before the restart."""
    ours, tensors = SB3VecEnv(ENV_ID, N, privileged=True, **SHORT), TorchVecEnv(ENV_ID, N, **SHORT)
    at = tensors.privileged_slices
    drawn = np.r_[at["parameters"], at["delay"], at["gauge_bias"]]
    ours.seed(4)
    seen: Any = ours.reset()
    expected = tensors.reset(seed=4)[0]
    rng = np.random.default_rng(0)
    for step in range(1, 2 * STEPS + 3):
        for name, numbers in {"observation": expected, "privileged": tensors.privileged()}.items():
            np.testing.assert_allclose(seen[name], numbers, **CLOSE)
            assert ours.observation_space[name].contains(seen[name][0])
        before = seen
        actions = rng.uniform(-1.0, 1.0, (N, 1)).astype(np.float32)
        seen, _, dones, infos = ours.step(actions)
        expected, *_, info = tensors.step(torch.from_numpy(actions))
        assert dones.all() == dones.any() == (step % STEPS == 0)
        for i in np.flatnonzero(dones):
            last = infos[i]["terminal_observation"]
            np.testing.assert_allclose(last["observation"], info["final_obs"][i], **CLOSE)
            assert last["privileged"][at["elapsed"]] == 1.0
            np.testing.assert_array_equal(last["privileged"][drawn], before["privileged"][i, drawn])
            assert (seen["privileged"][i, drawn] != before["privileged"][i, drawn]).any()


def test_a_critic_sees_the_targets_of_episodes_that_were_placed() -> None:
    """And the parameters of their plants, from -1 to 1 over the ranges."""
    envs = SB3VecEnv(ENV_ID, 2, privileged=True, hardware="laboratory")
    at = TorchVecEnv(ENV_ID, 1, hardware="laboratory").privileged_slices
    envs.reset()
    envs.set_options([{"target": [0.5]}, {}])
    seen: Any = envs.reset()
    ahead = (envs.core.joint_target() - envs.core.joint_state()[0]) / 0.5
    assert envs.core.joint_target()[0] == 0.5
    np.testing.assert_allclose(seen["privileged"][:, at["target_now"]], ahead, **CLOSE)
    low, high = np.transpose(list(envs.core.randomize.values()))
    share = (envs.core.parameters - low) / (high - low)
    np.testing.assert_allclose(seen["privileged"][:, at["parameters"]], 2.0 * share - 1.0, **CLOSE)


def test_episodes_are_recorded_as_by_a_monitor_and_by_no_other_wrapper() -> None:
    envs = SB3VecEnv(ENV_ID, 2)
    assert envs.env_is_wrapped(Monitor) == [True, True]
    assert envs.env_is_wrapped(TimeLimit, [1]) == [False]


def test_a_part_for_the_critic_is_asked_for_by_a_truth_and_not_of_goals() -> None:
    with pytest.raises(ValueError, match="privileged must be true or false, got 1"):
        SB3VecEnv(ENV_ID, 2, privileged=1)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"privileged=True takes .* got obs='goal', .* leave priv"):
        SB3VecEnv("FlexArm/OneLink-ReachGoal-v0", 2, privileged=True)
