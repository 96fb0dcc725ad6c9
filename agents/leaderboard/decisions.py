"""Times of decisions, and controllers that miss their control step: they act late."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.controllers.models.memory import fresh_of
from agents.policy import Controller
from dynamics.types import AnyArray

TIMED = 200  # control steps in which decisions are timed
TOLERATED = 0.01  # share of late decisions up to which a controller is judged as if in time


def decision_times(subject: Controller, env: Any, seed: int) -> AnyArray:
    """(T,) [ms] of single decisions in TIMED steps of one environment.

    The first one of an episode starts filters and plans; of these only the very first is among
    them.
    """
    observation, _ = env.reset(seed=[seed])
    state, start = None, np.ones(1, dtype=bool)
    times: list[float] = []
    for _ in range(TIMED):
        begin = time.perf_counter()
        action, state = subject.predict(observation, state, start)
        if not (times and start[0]):
            times.append(1e3 * (time.perf_counter() - begin))
        observation, _, terminated, truncated, _ = env.step(np.asarray(action, np.float32))
        start = terminated | truncated
    return np.array(times)


def lateness(milliseconds: AnyArray, control_dt: float) -> AnyArray:
    """(T,) whole control steps [s] by which decisions come late; zeros if few of them do."""
    steps = np.maximum(np.ceil(milliseconds / (1e3 * control_dt)) - 1, 0).astype(np.int64)
    return steps if np.mean(steps > 0) > TOLERATED else np.zeros_like(steps)


@dataclass
class _Waiting:
    """Memory of `Late` for N environments and decisions of the last K steps, the latest first."""

    inner: Any
    actions: AnyArray  # (K, N, m)
    due: AnyArray  # (K, N) control steps of the episode from which they may act
    held: AnyArray  # (N, m) what acts
    step: AnyArray  # (N,) control steps since the start of the episode


class Late:
    """A controller whose decisions act when they are made; until then, what acted before goes on.

    `steps` (T,) are measured delays in control steps. Episode i has them in their order, from the
    i-th on. Decisions do not wait for one another, and one that comes after a later one never acts.
    The controller is not told: it takes its actions for those that act.
    """

    def __init__(self, controller: Controller, steps: AnyArray) -> None:
        self.controller, self.steps = controller, steps

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: AnyArray | None = None,
        deterministic: bool = True,
    ) -> tuple[AnyArray, Any]:
        """Actions that act now, and the memory."""
        inner = state.inner if state else None
        action, inner = self.controller.predict(observation, inner, episode_start, deterministic)
        new = np.asarray(action, np.float64)
        count, most = len(new), int(self.steps.max()) + 1
        fresh = fresh_of(state, episode_start, count)
        if state is None:
            state = _Waiting(
                inner,
                actions=np.zeros((most, *new.shape)),
                due=np.zeros((most, count), np.int64),
                held=np.zeros_like(new),
                step=np.zeros(count, np.int64),
            )
        step = np.where(fresh, 0, state.step)
        held = np.where(fresh[:, None], 0.0, state.held)
        due = np.where(fresh, np.iinfo(np.int64).max, state.due)
        late = self.steps[(np.arange(count) + step) % len(self.steps)]
        actions = np.concatenate([new[None], state.actions[:-1]])
        due = np.concatenate([(step + late)[None], due[:-1]])
        ready = due <= step
        acts = np.argmax(ready, axis=0)  # the latest decision that is made
        some: AnyArray = np.any(ready, axis=0)
        held = np.where(some[:, None], actions[acts, np.arange(count)], held)
        return held, _Waiting(inner, actions, due, held, step + 1)
