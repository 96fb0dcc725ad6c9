"""A batch of tensors gives the numbers of Gymnasium's batch, on the same memory."""

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

import flexarm_env
from flexarm_env import TorchVecEnv

N, STEPS = 20, 40
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "plain": ("OneLink-Reach", {}),
    "laboratory": ("OneLink-Reach", {"hardware": "laboratory", "dtype": "float32"}),
    "goals": ("TwoLink-Reach", {"obs": "goal"}),
    "drop": ("OneLink-TrackDrop", {"control_dt": 0.05}),
    "free base": ("FreeFlyer-Reach", {"randomize": {"payload_mass": (0.0, 0.1)}}),
}


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    """An id and keywords, with episodes that end within the test."""
    name, keywords = CASES[request.param]
    return f"FlexArm/{name}-v0", keywords | {"max_episode_steps": 15}


def actions() -> Any:
    return np.random.default_rng(0).uniform


def arrays(obs: Any) -> list[Any]:
    """Arrays of an observation, which may be a dict."""
    return [np.asarray(x) for x in (obs.values() if isinstance(obs, dict) else [obs])]


def test_tensors_equal_the_arrays_of_gymnasium(case: tuple[str, dict[str, Any]]) -> None:
    """Bit for bit, across the ends of episodes; the last observation is Gymnasium's."""
    env_id, keywords = case
    envs, tensors = (
        gym.make_vec(env_id, num_envs=N, autoreset_mode="SameStep", **keywords),
        TorchVecEnv(env_id, N, **keywords),
    )
    first, _ = envs.reset(seed=3)
    obs, _ = tensors.reset(seed=3)
    for a, b in zip(arrays(first), arrays(obs), strict=True):
        np.testing.assert_array_equal(a, b)
    draw, ends = actions(), 0
    for _ in range(STEPS):
        action = draw(-1.0, 1.0, envs.action_space.shape).astype(np.float32)
        expected = envs.step(action)
        obs, *outcome, info = tensors.step(torch.from_numpy(action))
        for a, b in zip(arrays(expected[0]), arrays(obs), strict=True):
            np.testing.assert_array_equal(a, b)
        for a, b in zip(expected[1:4], outcome, strict=True):
            np.testing.assert_array_equal(a, b.numpy())
        done = expected[2] | expected[3]
        for i in np.flatnonzero(done):
            ends += 1
            final = expected[4]["final_info"]["tip_error"][i]
            assert info["tip_error"][i].item() == final
            last = arrays(expected[4]["final_obs"][i])
            for a, b in zip(last, arrays(info["final_obs"]), strict=True):
                np.testing.assert_array_equal(a, b[i])
        for i in np.flatnonzero(~done):
            assert info["tip_error"][i].item() == expected[4]["tip_error"][i]
    assert ends > N


def test_tensors_are_not_overwritten_while_they_are_kept() -> None:
    """Also where episodes end, and others begin in the same step."""
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", N, max_episode_steps=3)
    kept, copies = [], []
    kept.append(envs.reset(seed=0)[0])
    copies.append(kept[0].clone())
    for _ in range(8):
        obs, reward, *_, info = envs.step(torch.rand(N, 1) - 0.5)
        kept += [obs, reward, info["tip_error"], info["final_obs"]]
        copies += [x.clone() for x in kept[-4:]]
    for a, b in zip(kept, copies, strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=0.0)


def test_results_share_the_memory_of_the_batch() -> None:
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", N)
    envs.reset(seed=0)
    obs, reward, terminated, _, info = envs.step(torch.zeros(N, 1))
    sets = envs.core._kept
    assert obs.data_ptr() in [out.obs.ctypes.data for out in sets]
    assert reward.data_ptr() in [out.reward.ctypes.data for out in sets]
    assert terminated.dtype == torch.bool
    assert info["final_obs"].data_ptr() == obs.data_ptr()
    assert not obs.requires_grad


def test_a_copy_reads_a_state_of_its_own() -> None:
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", 3)
    envs.reset(seed=0)
    for other in (copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))):
        before = envs.privileged()
        other.step(torch.ones(3, 1))
        assert not torch.equal(other.privileged(), before)
        assert torch.equal(other.state, torch.from_numpy(other.core.state)[:, :3])
        assert torch.equal(envs.privileged(), before)


def test_numbers_of_a_critic_are_those_of_the_state() -> None:
    """Joints, the target, the elapsed share, and parameters from -1 to 1 over their ranges."""
    keywords: dict[str, Any] = {"hardware": "laboratory", "max_episode_steps": 10}
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", 64, **keywords)
    envs.reset(seed=1)
    for _ in range(4):
        envs.step(torch.rand(64, 1) - 0.5)
    core, found, at = envs.core, envs.privileged(), envs.privileged_slices
    assert found.shape == (64, sum(s.stop - s.start for s in at.values()))
    assert found.dtype == torch.float32
    q, v = core.joint_state()
    ahead = (core.joint_target() - q) / 0.5
    np.testing.assert_allclose(found[:, at["target_now"]], ahead, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(found[:, at["joint_rate"]], v / core.rate_scale, rtol=1e-5)
    angle, bent = (q - core.scales.home) / 1.3, core.q[:, 1:] / core.scales.modal_scale
    np.testing.assert_allclose(found[:, at["joint_angle"]], angle, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(found[:, at["modal_amplitude"]], bent, rtol=1e-5, atol=1e-6)
    assert found[:, at["elapsed"]] == pytest.approx(0.4)
    for j, (low, high) in enumerate(core.randomize.values()):
        share = 2.0 * (core.parameters[:, j] - low) / (high - low) - 1.0
        np.testing.assert_allclose(found[:, at["parameters"].start + j], share, atol=1e-6)
    drawn = found[:, at["delay"]]
    assert 0.0 <= drawn.min() <= drawn.max() <= 1.0


def test_a_critic_knows_the_event() -> None:
    """If it has happened, its time over its range, and its signed sizes over the largest."""
    envs = TorchVecEnv("FlexArm/TwoLink-ReachJump-v0", 32, control_dt=0.2, max_episode_steps=30)
    envs.reset(seed=0)
    before = envs.core.joint_target()
    for _ in range(15):
        info = envs.step(torch.zeros(32, 2))[-1]
    found = envs.privileged()[:, envs.privileged_slices["event"]].numpy()
    jump = envs.core.joint_target() - before
    happened = (jump != 0.0).all(axis=1)
    assert 0 < happened.sum() < 32
    np.testing.assert_array_equal(found[:, 0], happened)
    np.testing.assert_array_equal(found[:, 0], info["event"])
    now = 15.0 * 0.2 / envs.core.move_time - 1.5  # of the range, 0.5 to 2.5 move times
    np.testing.assert_array_equal(found[:, 1] < now, happened)
    assert np.abs(found[:, 1:]).max() <= 1.0
    np.testing.assert_allclose(np.abs(found[happened, 2:]), np.abs(jump[happened]) / 0.8, rtol=1e-6)


def test_a_critic_follows_changed_ranges() -> None:
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", 8, randomize={"payload_mass": (0.0, 0.1)})
    envs.reset(seed=1)
    before = envs.privileged()[:, envs.privileged_slices["parameters"]]
    envs.randomize = {"payload_mass": (0.0, 0.2)}
    after = envs.privileged()[:, envs.privileged_slices["parameters"]]
    torch.testing.assert_close(0.5 * (before + 1.0), after + 1.0)


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"autoreset_mode": "NextStep"}, "autoreset_mode is not a keyword .* same step"),
        ({"render_mode": "human"}, "pictures come from"),
        ({"wrappers": []}, "wrappers take NumPy arrays"),
        ({"device": "meta"}, "'cpu' or 'cuda', got 'meta'"),
        ({"device": "abacus"}, "'cpu' or 'cuda', got 'abacus'"),
    ],
)
def test_what_it_cannot_do_is_refused_with_a_remedy(
    keywords: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        TorchVecEnv("FlexArm/OneLink-Reach-v0", 2, **keywords)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (np.zeros((2, 1)), "torch.as_tensor"),
        (torch.zeros(2), r"shape \(2, 1\)"),
        (torch.full((2, 1), torch.nan), "finite"),
        (torch.zeros(2, 1, device="meta"), r"actions.to\('cpu'\)"),
        (torch.zeros(2, 1, dtype=torch.complex64), r"real numbers, got torch.complex64 .*\.real"),
        (torch.zeros(2, 1).to_sparse(), r"dense tensor .* layout torch.sparse_coo; .*to_dense"),
    ],
)
def test_wrong_actions_are_refused(given: Any, sentence: str) -> None:
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", 2)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=sentence):
        envs.step(given)


def test_keywords_change_as_in_the_batch() -> None:
    envs = TorchVecEnv("FlexArm/OneLink-Reach-v0", 2)
    envs.max_episode_steps = 5
    envs.deflection_limit = 0.08
    assert (envs.core.max_steps, envs.core.settings.deflection_limit) == (5, 0.08)
    with pytest.raises(ValueError, match="cannot change"):
        envs.obs = "sensors"  # type: ignore[attr-defined]
    assert flexarm_env.TorchVecEnv is TorchVecEnv


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_answered_with_the_remedy() -> None:
    with pytest.raises(ValueError, match=r"needs an NVIDIA GPU .* device='cpu' steps the same"):
        TorchVecEnv("FlexArm/OneLink-Reach-v0", 2, device="cuda")
