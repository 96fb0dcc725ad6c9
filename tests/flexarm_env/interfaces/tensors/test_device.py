"""The batch of a GPU, its kernels compiled for the host: equal episodes, restarts in the kernel."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

import flexarm_env
from flexarm_env import TorchVecEnv
from flexarm_env.interfaces.tensors.device import DeviceBatch
from flexarm_env.interfaces.tensors.host import HostBatch
from flexarm_env.interfaces.vector import FlexArmVectorEnv
from tests.host_kernels import COMPILER, HostKernels

N, STEPS = 20, 40
SAGGING = {
    "gravity": [0.0, -9.81, 0.0],
    "links": [{"length": 0.8, "rho_A": 0.12, "EIz": 6.0, "tip_mass": 0.15, "damping_ratio": 0.01,
               "modes": [{"kind": "poly", "index": k, "direction": "y"} for k in (1, 2)],
               "joint": {"rotor_inertia": 0.02}}],
}  # fmt: skip
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "plain": ("OneLink-Reach", {}),
    "laboratory": ("OneLink-Reach", {"hardware": "laboratory"}),
    "actuator": ("OneLink-Track", {"actuator": "quanser-servo"}),
    "vibration": ("TwoLink-Damp", {"randomize": {"payload_mass": (0.0, 0.1)}}),
    "gravity": ("OneLink-Reach", {"arm": SAGGING, "randomize": {"stiffness": (0.8, 1.2)}}),
    # a longer control step brings events into short episodes
    "push": ("OneLink-ReachPush", {"hardware": "laboratory", "control_dt": 0.05}),
    "drop": ("FreeFlyer-Reach", {"event": "drop", "control_dt": 0.2}),
    "jump": ("TwoLink-ReachJump", {"control_dt": 0.2, "curvature_limit": 0.1}),
    "goal": ("TwoLink-ReachGoal", {}),
    "free base": ("FreeFlyer-Reach", {"hardware": "laboratory"}),
}
TOLERANCES = {"float64": 1e-12, "float32": 1e-4}
ROUNDED = {"free base": 10.0}  # times as much in float32: round-off turns a gauge by one step

pytestmark = pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")


def made(env_id: str, **keywords: Any) -> Any:
    envs = gym.make_vec(env_id, num_envs=N, autoreset_mode="SameStep", **keywords)
    assert isinstance(envs, FlexArmVectorEnv)
    return envs


def both(env_id: str, **keywords: Any) -> tuple[Any, Any, HostBatch, DeviceBatch]:
    """Two batches of an id, one of the processor and one of kernels, and their environments."""
    first, second = made(env_id, **keywords), made(env_id, **keywords)
    kernels = DeviceBatch(second.core, torch.device("cpu"), HostKernels)
    return first, second, HostBatch(first), kernels


def started(batch: Any, envs: Any, seed: int | None = 3, options: Any = None) -> Any:
    envs.seed_streams(seed)
    return batch.reset(options)


def largest_gap(a: torch.Tensor, b: torch.Tensor) -> float:
    """Largest difference, relative to numbers above 1."""
    return float(((a - b).abs() / (1.0 + b.abs())).max())


@pytest.mark.parametrize("dtype", TOLERANCES)
@pytest.mark.parametrize("name", CASES)
def test_a_seed_gives_the_same_episodes_on_both(name: str, dtype: str) -> None:
    """States, observations, rewards and info of whole episodes; flags and streams exactly."""
    env_id, keywords = CASES[name]
    host_envs, device_envs, host, device = both(
        f"FlexArm/{env_id}-v0", dtype=dtype, max_episode_steps=15, **keywords
    )
    most = TOLERANCES[dtype] * (ROUNDED.get(name, 1.0) if dtype == "float32" else 1.0)
    a, b = started(device, device_envs)[0], started(host, host_envs)[0]
    assert largest_gap(a, b) <= most
    rng, ends = np.random.default_rng(0), 0
    for _ in range(STEPS):
        action = rng.uniform(-1.0, 1.0, (N, host_envs.core.arm.n_torque)).astype(np.float32)
        given = torch.from_numpy(action)
        found, expected = device.step(given), host.step(given)
        assert torch.equal(found.terminated, expected.terminated)
        assert torch.equal(found.truncated, expected.truncated)
        assert largest_gap(device.state, host.state) <= most
        assert largest_gap(found.obs, expected.obs) <= most
        assert largest_gap(found.last, expected.last) <= most
        assert largest_gap(found.reward, expected.reward) <= most
        assert found.reward.dtype == expected.reward.dtype
        for key in ("tip_error", "torque", "root_curvature", "time"):
            assert largest_gap(found.info[key], expected.info[key]) <= most, key
        assert found.info.keys() == expected.info.keys()
        assert torch.equal(device._streams, torch.from_numpy(host_envs.core.streams))
        ends += int((found.terminated | found.truncated).sum())
    assert ends >= N


def test_sixty_steps_of_six_links_are_the_same_on_both() -> None:
    """The longest recursion, in float64."""
    host_envs, device_envs, host, device = both("FlexArm/SixLink-Reach-v0", max_episode_steps=50)
    started(device, device_envs), started(host, host_envs)
    rng = np.random.default_rng(0)
    for _ in range(60):
        action = torch.from_numpy(rng.uniform(-0.5, 0.5, (N, 6)).astype(np.float32))
        found, expected = device.step(action), host.step(action)
        assert largest_gap(found.obs, expected.obs) < 1e-9  # of chaotic motion
    assert largest_gap(device.state, host.state) < 1e-9


def test_later_resets_go_on_with_the_streams_of_the_device() -> None:
    host_envs, device_envs, host, device = both("FlexArm/OneLink-Reach-v0", max_episode_steps=2)
    started(device, device_envs), started(host, host_envs)
    for _ in range(5):
        host.step(torch.zeros(N, 1)), device.step(torch.zeros(N, 1))
    found, expected = started(device, device_envs, None)[0], started(host, host_envs, None)[0]
    assert torch.equal(found, expected)
    assert torch.equal(started(device, device_envs, 3)[0], started(host, host_envs, 3)[0])


def test_options_place_episodes_and_wrong_ones_are_refused() -> None:
    host_envs, device_envs, host, device = both("FlexArm/OneLink-Reach-v0")
    placed = {"state": {"q": [0.3, 0.0, 0.0]}, "target": [0.7]}
    found, expected = (
        started(batch, envs, 0, placed)
        for batch, envs in ((device, device_envs), (host, host_envs))
    )
    assert torch.equal(found[0], expected[0])
    with pytest.raises(ValueError, match="must bend no link"):
        started(device, device_envs, 0, {"state": {"q": [0.0, 9.0, 0.0]}})


def test_changed_keywords_hold_from_the_next_step() -> None:
    host_envs, device_envs, host, device = both(
        "FlexArm/OneLink-Reach-v0", randomize={"payload_mass": (0.0, 0.1)}, max_episode_steps=3
    )
    started(device, device_envs), started(host, host_envs)
    for envs in (host_envs, device_envs):
        envs.reward = {"effort": 1.0}
        envs.randomize = {"payload_mass": (0.2, 0.3)}
    for _ in range(4):
        action = torch.full((N, 1), 0.5)
        found, expected = device.step(action), host.step(action)
        assert largest_gap(found.reward, expected.reward) < 1e-12
    masses = device.state[device_envs.core.signals.state.slices["free"]]
    assert float(masses.min()) >= 0.2


def test_an_action_that_is_no_number_ends_its_episode() -> None:
    _, envs, _, device = both("FlexArm/OneLink-Reach-v0")
    started(device, envs)
    action = torch.zeros(N, 1)
    action[3] = torch.nan
    found = device.step(action)
    assert found.terminated.nonzero().ravel().tolist() == [3]
    assert found.info["diverged"].nonzero().ravel().tolist() == [3]
    assert bool(torch.isfinite(found.obs).all() and torch.isfinite(found.reward).all())


def test_a_tip_on_its_goal_is_rewarded_on_both() -> None:
    host_envs, device_envs, host, device = both("FlexArm/OneLink-ReachGoal-v0")
    placed = {"state": {"q": [0.3, 0.0, 0.0]}, "target": [0.31]}
    started(device, device_envs, 0, placed), started(host, host_envs, 0, placed)
    torque = torch.linspace(-1.0, 1.0, N)[:, None]  # which turns some tips out of the settled band
    for _ in range(20):
        found, expected = device.step(torque), host.step(torque)
        assert torch.equal(found.reward, expected.reward)
    assert 0.0 < float(found.reward.mean()) < 1.0


def test_a_batch_of_tensors_runs_on_kernels() -> None:
    """All of `TorchVecEnv` but the launch itself."""
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", N, hardware="laboratory", dtype="float32")
    envs._batch = DeviceBatch(envs.core, torch.device("cpu"), HostKernels)
    obs, _ = envs.reset(seed=0)
    kept = obs.clone()
    later, reward, _, _, info = envs.step(torch.zeros(N, 1))
    assert torch.equal(obs, kept)
    assert later.shape == info["final_obs"].shape == obs.shape
    assert reward.shape == (N,)
    assert envs.privileged().shape[0] == N
    assert flexarm_env.TorchVecEnv is TorchVecEnv
    for copied in (envs.core.q, envs.core.v, envs.core.parameters):
        with pytest.raises(ValueError, match="read-only"):
            copied[...] = 0.1  # which the kernels would not see
