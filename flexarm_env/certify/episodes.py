"""Whole episodes of an environment, and the distance of its tip between two models of the arm."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from dynamics.accuracy.same_shape import transferred
from dynamics.description.arm import Arm
from dynamics.simulation.statics import RigidArm
from dynamics.tracing import graphs
from dynamics.tracing.equilibrium import settled
from dynamics.types import AnyArray, Array
from flexarm_env.accuracy.motions import KINDS, Kind, Recorded, recorded
from flexarm_env.compiled.termination import FLAGS
from flexarm_env.core import Core
from flexarm_env.task.scales import RIGID_PERIOD
from flexarm_env.task.tasks import TASKS

SHARE = 0.95  # of the episodes of a kind that stay within a stated error
CHUNK = 4096  # states whose tips are computed together
TERMINATED, DIVERGED = FLAGS.index("terminated"), FLAGS.index("diverged")
THREADS = max(1, min(8, os.cpu_count() or 1))


@dataclass(frozen=True)
class Trace:
    """Tips of N episodes after each of T control steps."""

    tips: Array  # (T, N, 3) [m]
    valid: AnyArray  # (T, N) the episode has not ended
    diverged: AnyArray  # (N,) it ended since the simulation diverged

    def of(self, rows: AnyArray) -> "Trace":
        """Some of the episodes."""
        return Trace(self.tips[:, rows], self.valid[:, rows], self.diverged[rows])

    def until(self, other: "Trace") -> "Trace":
        """The episodes as far as those of another trace."""
        valid = self.valid & other.valid
        longer = self.valid.sum(axis=0) >= other.valid.sum(axis=0)
        return Trace(self.tips, valid, self.diverged & ~longer)


@dataclass(frozen=True)
class Episodes:
    """Starts and actions of episodes of several kinds."""

    kinds: tuple[str, ...]  # (N,) of each episode
    q: Array  # (N, n) start in the coordinates of `arm`
    v: Array  # (N, n)
    actions: Array  # (T, N, n_torque)
    arm: Arm
    seeds: tuple[int, ...]  # (N,) of the drawn parameters

    @classmethod
    def drawn(cls, core: Core, names: Sequence[str], count: int, steps: int) -> "Episodes":
        """`count` episodes of each kind for the arm and torques of an environment."""
        arm, played = core.arm, recorded(core.arm.name, core.torque_limit)
        period = 2.0 * np.pi / core.scales.free[0] if core.scales.free else RIGID_PERIOD
        names = [name for name in names if name in played or KINDS[name].actions]
        parts: list[tuple[Array, Array, Array]] = []
        for name in names:
            if name in played:
                parts.append(_as_recorded(arm, played[name], count, steps))
            else:
                parts.append(_random(core, name, count, steps, core.control_dt / period))
        q, v = (np.vstack([part[k] for part in parts]) for k in range(2))
        actions = np.concatenate([part[2] for part in parts], axis=1)
        kinds = tuple(name for name in names for _ in range(count))
        seeds = tuple(range(len(kinds)))
        return cls(kinds, q, v, actions, arm, seeds)

    def of(self, rows: AnyArray) -> "Episodes":
        """Some of the episodes."""
        kinds, seeds = (tuple(np.array(x)[rows].tolist()) for x in (self.kinds, self.seeds))
        return Episodes(kinds, self.q[rows], self.v[rows], self.actions[:, rows], self.arm, seeds)

    def played(
        self, core: Core, disturbance: float = 0.0, watch: Callable[[], None] | None = None
    ) -> Trace:
        """Play the episodes on an environment of as many arms, of any model of the arm.

        Every joint starts `disturbance` [rad] beside the start. `watch` is called after every
        control step.
        """
        rows = np.arange(core.n_env)
        for row, seed in enumerate(self.seeds):
            core.seed(row, seeding.np_random(seed)[0])
        q, v = transferred(self.q, self.v, self.arm, core.arm)
        q[:, list(core.arm.joint_index)] += disturbance
        core.reset(rows, {"state": {"q": q, "v": v}})
        states, going = [], []
        valid, diverged = np.ones(core.n_env, dtype=bool), np.zeros(core.n_env, dtype=bool)
        for action in self.actions.astype(np.float32):
            out, _ = core.step(np.ascontiguousarray(action))
            flags = out.flags[:, : core.n_env].astype(bool)
            diverged |= valid & flags[DIVERGED]
            valid &= ~flags[TERMINATED]
            going.append(valid.copy())
            states.append(core.q.copy())
            if watch:
                watch()
        tips = _tips(core, np.concatenate(states))
        return Trace(tips.reshape(len(states), core.n_env, 3), np.array(going), diverged)


@dataclass(frozen=True)
class Distances:
    """Tip distance between two traces until either ends; infinite where one of them diverges."""

    largest: Array  # (T, N) [m] up to each time; NaN after the end of an episode
    kinds: tuple[str, ...]

    @classmethod
    def between(cls, a: Trace, b: Trace, kinds: tuple[str, ...]) -> "Distances":
        apart = np.linalg.norm(a.tips - b.tips, axis=2)
        both = a.valid & b.valid
        largest = np.maximum.accumulate(np.where(both, apart, 0.0), axis=0)
        largest = np.where(both, largest, np.nan)
        lengths = a.valid.sum(axis=0), b.valid.sum(axis=0)
        lost = np.where(a.diverged, lengths[0] < lengths[1], b.diverged & (lengths[1] < lengths[0]))
        largest[0, lost] = np.inf
        return cls(largest, kinds)

    def of(self, kind: str) -> Array:
        """(T, n) of the episodes of a kind."""
        return self.largest[:, np.array(self.kinds) == kind]

    @cached_property
    def per_episode(self) -> Array:
        """(N,) [m] largest of each episode; zero of one that ends at once."""
        return np.max(np.nan_to_num(self.largest, nan=0.0, posinf=np.inf), axis=0)

    def share(self, kind: str) -> float:
        """[m] within which SHARE of the episodes of a kind stay."""
        own = self.per_episode[np.array(self.kinds) == kind]
        return float(np.quantile(own, SHARE, method="higher"))

    @property
    def worst_share(self) -> float:
        """[m] largest `share` of all kinds."""
        return max(map(self.share, {*self.kinds}))

    def curve(self, kind: str) -> Array:
        """(T,) [m] within which SHARE of the episodes that go on stay; NaN where none does."""
        result = np.full(len(self.largest), np.nan)
        for k, row in enumerate(self.of(kind)):
            going = row[~np.isnan(row)]
            if going.size:
                result[k] = np.quantile(going, SHARE, method="higher")
        return result


def _random(
    core: Core, name: str, count: int, steps: int, step: float
) -> tuple[Array, Array, Array]:
    """Starts and actions of a kind; `step` is a control step in periods."""
    rng, kind = np.random.default_rng([0, sum(name.encode())]), KINDS[name]
    assert kind.actions is not None
    shares = kind.actions(rng, (steps, count, core.torque_limit.size), step)
    q, v = _start(core, kind, count, rng)
    return q, v, _with_holding(core, q, shares)


def _as_recorded(arm: Arm, found: Recorded, count: int, steps: int) -> tuple[Array, Array, Array]:
    """Starts and actions of recorded episodes; the actions end with zeros."""
    q, actions = np.zeros((count, arm.n)), np.zeros((steps, count, found.actions.shape[2]))
    chosen = np.arange(count) % len(found.start)
    q[:, list(arm.joint_index)] = found.start[chosen]
    known = found.actions[:steps, chosen]
    actions[: len(known)] = known
    return q, np.zeros_like(q), actions


def _start(core: Core, kind: Kind, count: int, rng: Any) -> tuple[Array, Array]:
    """(count, n) coordinates and rates of the starts of Reach, or of Damp if `kind.shaken`."""
    arm, found = core.arm, core.scales
    task = TASKS["Damp" if kind.shaken else "Reach"]
    joints = list(arm.joint_index)
    q, v = np.zeros((2, count, arm.n))
    q[:, : arm.base.n] = arm.base.q
    q[:, joints] = found.home + rng.uniform(*task.start, (count, arm.n_joint))
    if core.signals.bent:
        q = settled(core.model.traced, q)
    modal = [i for i in range(arm.base.n, arm.n) if i not in joints]
    for x, shapes in ((q, found.vibration), (v, found.vibration_rate)):
        if kind.shaken and modal:
            share = rng.uniform(*task.shake, (count, len(shapes)))
            x[:, modal] += share @ np.reshape(shapes, (len(shapes), len(modal)))
    return q, v


def _with_holding(core: Core, q: Array, shares: Array) -> Array:
    """Actions that add shares of the torque for motion to what holds the arm at its start."""
    arm, limit = core.arm, core.torque_limit
    if not any(arm.gravity):
        return shares
    rigid, joints = RigidArm(arm), list(arm.joint_index)
    static = np.array([rigid.torque(j, q[:, joints]) for j in range(arm.n_joint)]).T
    room = np.append(core.scales.motion_torque, limit[arm.n_joint :])
    held = np.zeros((len(q), limit.size))
    held[:, : arm.n_joint] = static
    result: Array = np.clip((held + shares * room) / limit, -1.0, 1.0)
    return result


def _tips(core: Core, q: Array) -> Array:
    """(N, 3) [m] in the world."""
    measure, at = graphs.measure(core.model.traced), core.model.measurements["tip"]
    chunks = []
    for first in range(0, len(q), CHUNK):
        part = q[first : first + CHUNK].T
        values = measure.map(part.shape[1])(part, np.zeros_like(part))
        chunks.append(np.array(values)[at].T)
    return np.vstack(chunks)


def environment(arm: Any, count: int, keywords: Mapping[str, Any]) -> Core:
    """A batch of an environment without a limit of time."""
    return Core(task="Reach", arm=arm, n_env=count, threads=THREADS, **keywords)
