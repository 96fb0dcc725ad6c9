"""What a step returned stays as it is; what nobody holds any more is filled again."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env  # noqa: F401
from flexarm_env.compiled.outputs import SPARE

STEPS = 8
HOLDS: dict[str, Callable[[tuple[Any, ...]], Any]] = {
    "observations": lambda result: result[0],
    "half an observation": lambda result: result[0][1:, 1],
    "rewards": lambda result: result[1],
    "some rewards": lambda result: result[1][::2],
    "truncated": lambda result: result[3],
    "one number of info": lambda result: result[4]["tip_error"],
    "a part of it": lambda result: result[4]["tip_error"][2:],
    "a wide one": lambda result: result[4]["torque"],
    "a mark": lambda result: result[4]["settled"],
    "reward terms": lambda result: result[4]["reward_terms"],
    "info": lambda result: result[4],
    "its memory": lambda result: memoryview(result[0]),
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


@pytest.mark.parametrize("hold", HOLDS.values(), ids=HOLDS)
def test_what_is_held_is_not_overwritten(batch: Any, hold: Callable[[Any], Any]) -> None:
    """Whatever part of a result is kept, later steps leave it alone."""
    rng = np.random.default_rng(0)
    held, copies = [], []
    for _ in range(STEPS):
        held.append(hold(batch.step(rng.uniform(-1.0, 1.0, (7, 1)))))
        copies.append(_copied(held[-1]))
    for here, before in zip(held, copies, strict=True):
        np.testing.assert_equal(_copied(here), before)


def test_what_nobody_holds_is_filled_again(batch: Any) -> None:
    """A training loop that keeps the last result alone takes turns with few sets of arrays."""
    places = set()
    for _ in range(STEPS):
        result = batch.step(np.zeros((7, 1)))
        places.add(result[0].ctypes.data)
    assert len(places) <= SPARE < STEPS


def test_a_single_environment_keeps_its_promises() -> None:
    """Observations and the arrays of info that are kept stay as they were."""
    env = gym.make("FlexArm/TwoLink-Reach-v0")
    held = [env.reset(seed=0)[0]]
    copies = [held[0].copy()]
    for _ in range(STEPS):
        obs, _, _, _, info = env.step(env.action_space.high)
        held += [obs, info["torque"], info["root_curvature"]]
        copies += [x.copy() for x in held[-3:]]
    np.testing.assert_equal(held, copies)


def _copied(x: Any) -> Any:
    """A copy that shares no memory."""
    if isinstance(x, dict):
        return {name: _copied(value) for name, value in x.items()}
    if isinstance(x, np.ndarray) and x.dtype == object:
        return [_copied(entry) for entry in x]
    return np.array(x, copy=True)
