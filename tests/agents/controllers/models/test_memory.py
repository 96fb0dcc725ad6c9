"""Controllers keep results for the next episode, but nothing keeps a controller."""

import gc
from weakref import ref

import pytest

from agents.controllers import CONTROLLERS, controller
from agents.controllers.models.memory import kept
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
