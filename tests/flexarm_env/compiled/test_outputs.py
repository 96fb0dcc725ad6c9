"""Arrays that a step returned are not overwritten while the caller refers to them."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env  # noqa: F401
from dynamics.runtime.jit import CACHE_LINE
from flexarm_env.compiled.outputs import SPARE
from flexarm_env.core import Core

STEPS = 8
KEPT_PARTS: dict[str, Callable[[tuple[Any, ...]], Any]] = {
    "observations": lambda result: result[0],
    "half an observation": lambda result: result[0][1:, 1],
    "rewards": lambda result: result[1],
    "some rewards": lambda result: result[1][::2],
    "truncated": lambda result: result[3],
    "one number of info": lambda result: result[4]["tip_error"],
    "part of a number of info": lambda result: result[4]["tip_error"][2:],
    "a vector of info": lambda result: result[4]["torque"],
    "a flag": lambda result: result[4]["settled"],
    "reward terms": lambda result: result[4]["reward_terms"],
    "info": lambda result: result[4],
    "memory of the observations": lambda result: memoryview(result[0]),
}


@pytest.fixture(scope="module", params=["NextStep", "SameStep"])
def batch(request: pytest.FixtureRequest) -> Any:
    """Seven arms whose episodes end within the test."""
    envs = gym.make_vec(
        "FlexArm/OneLink-Reach-v0", num_envs=7, max_episode_steps=3, autoreset_mode=request.param
    )
    envs.reset(seed=0)
    yield envs
    envs.close()


@pytest.mark.parametrize("part", KEPT_PARTS.values(), ids=KEPT_PARTS)
def test_a_kept_part_of_a_result_is_not_overwritten(batch: Any, part: Callable[[Any], Any]) -> None:
    rng = np.random.default_rng(0)
    kept, copies = [], []
    for _ in range(STEPS):
        kept.append(part(batch.step(rng.uniform(-1.0, 1.0, (7, 1)))))
        copies.append(_copied(kept[-1]))
    for now, before in zip(kept, copies, strict=True):
        np.testing.assert_equal(_copied(now), before)


def test_arrays_that_nobody_refers_to_are_reused(batch: Any) -> None:
    """A training loop that keeps only the last result uses few sets of arrays."""
    places = set()
    for _ in range(STEPS):
        result = batch.step(np.zeros((7, 1)))
        places.add(result[0].ctypes.data)
    assert len(places) <= SPARE < STEPS


@pytest.mark.parametrize("n_env", [1, 7, 64])
def test_state_and_outputs_begin_at_a_cache_line(n_env: int) -> None:
    """Every row of a batch's state and info too."""
    core = Core(task="Reach", arm="two-link", n_env=n_env)
    out = core.outputs()
    for array in (core.state, out.obs, out.info, out.flags):
        assert array.ctypes.data % CACHE_LINE == 0
    if n_env > 1:
        assert core.state.strides[0] % CACHE_LINE == out.info.strides[0] % CACHE_LINE == 0


def test_a_single_environment_returns_arrays_of_its_own() -> None:
    """Later steps do not change observations and info arrays."""
    env = gym.make("FlexArm/TwoLink-Reach-v0")
    kept = [env.reset(seed=0)[0]]
    copies = [kept[0].copy()]
    for _ in range(STEPS):
        obs, _, _, _, info = env.step(env.action_space.high)
        kept += [obs, info["torque"], info["root_curvature"]]
        copies += [x.copy() for x in kept[-3:]]
    np.testing.assert_equal(kept, copies)


def _copied(x: Any) -> Any:
    """A copy that shares no memory."""
    if isinstance(x, dict):
        return {name: _copied(value) for name, value in x.items()}
    if isinstance(x, np.ndarray) and x.dtype == object:
        return [_copied(entry) for entry in x]
    return np.array(x, copy=True)
