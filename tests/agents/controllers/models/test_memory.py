"""Controllers keep results for the next episode, but nothing keeps a controller."""

import gc
from dataclasses import dataclass
from typing import Any
from weakref import ref

import numpy as np
import pytest

from agents.controllers import CONTROLLERS, controller
from agents.controllers.models.memory import kept, part_of
from agents.leaderboard.tracks import keywords
from agents.metrics import make_batch


class Doubling:
    """Counts how often it doubles."""

    def __init__(self) -> None:
        self.calls, self.twice = 0, kept(self._double, 2)

    def _double(self, x: int) -> int:
        self.calls += 1
        return 2 * x


def test_the_latest_results_are_kept() -> None:
    subject = Doubling()
    assert [subject.twice(x) for x in (1, 2, 1, 3, 1, 2)] == [2, 4, 2, 6, 2, 4]
    assert subject.calls == 4  # 2 went when 3 came


@dataclass
class State:
    numbers: np.ndarray
    names: list[str]
    inner: Any
    clock: float = 0.5


def test_a_part_of_a_state_has_some_of_the_environments() -> None:
    """Of what has them as first dimension; all else is common to them."""
    numbers = np.arange(6.0).reshape(3, 2)
    state = State(numbers, ["a", "b", "c"], State(numbers + 7.0, [*"xyz"], None))
    part = part_of(state, np.array([2, 0]))
    assert part.numbers.tolist() == [[4.0, 5.0], [0.0, 1.0]]
    assert (part.names, part.inner.names) == (["c", "a"], ["z", "x"])
    assert part.inner.numbers.tolist() == (part.numbers + 7.0).tolist()
    assert (part.inner.inner, part.clock) == (None, 0.5)


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_a_controller_goes_when_nobody_holds_it(name: str) -> None:
    """At once, without the garbage collector, which large filters would not wake in time."""
    envs = make_batch("FlexArm/OneLink-Reach-v0", 2, keywords(name, "state"))
    observation, _ = envs.reset(seed=0)
    controller(name, envs).predict(observation)  # compiles
    gc.disable()
    try:
        subject = controller(name, envs)
        subject.predict(observation)
        parts = [ref(x) for x in (subject, *vars(subject).values()) if hasattr(x, "__weakref__")]
        del subject
        left = [type(part()).__name__ for part in parts]
        assert set(left) <= {"NoneType", "Reading", "LinearModels", "type", "function"}
    finally:
        gc.enable()
