"""The soak test finds no fault, and counts every kind of fault that is injected."""

from typing import Any

import numpy as np
import pytest

from benchmarks.speed import soak

ENV_ID = "FlexArm/OneLink-Reach-v0"


def test_a_short_soak_finds_every_kind_of_end_and_no_fault() -> None:
    counts = soak.soak(ENV_ID, 200 * soak.BATCH)
    assert counts["steps"] >= 200 * soak.BATCH
    assert min(counts[name] for name in ("time out", "invalid", "diverged")) > 0
    assert {name: counts[name] for name in soak.WRONG} == dict.fromkeys(soak.WRONG, 0)


def test_goals_are_soaked_too() -> None:
    watched = soak.Soak("FlexArm/OneLink-ReachGoal-v0", torque=1.0)
    for _ in range(5):
        watched.step()
    assert {name: watched.counts[name] for name in soak.WRONG} == dict.fromkeys(soak.WRONG, 0)
    assert watched.counts["steps"] == 5 * soak.BATCH


def spoil(wrong: str, obs: Any, terminated: Any, info: dict[str, Any], before: Any) -> None:
    """Inject a fault into the step of one environment."""
    if wrong == "not finite":
        info["tip_speed"][3] = np.nan
    elif wrong == "out of bounds":
        obs[3, 0] = 1e3
    elif wrong == "clock wrong":
        info["time"][3] = 0.0
    elif wrong == "divergence not said":
        info["diverged"][3] = True
        terminated[3] = False
    else:
        obs[3] = before[3]


@pytest.mark.parametrize("wrong", soak.WRONG)
def test_every_kind_of_fault_is_counted(wrong: str) -> None:
    watched = soak.Soak(ENV_ID, torque=0.1)
    watched.step()
    real = watched.envs.step

    def step(actions: Any) -> Any:
        obs, reward, terminated, truncated, info = real(actions)
        spoil(wrong, obs, terminated, info, watched.before)
        return obs, reward, terminated, truncated, info

    watched.envs.step = step  # type: ignore[method-assign]
    watched.step()
    assert {name for name in soak.WRONG if watched.counts[name]} == {wrong}
    assert watched.counts[wrong] == 1
