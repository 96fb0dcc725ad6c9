"""Whole episodes of an environment, and the distance of its tip between two models of the arm."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from dynamics.accuracy.same_shape import transferred
from dynamics.description.arm import Arm
from dynamics.simulation.statics import RigidArm
from dynamics.tracing import graphs
from dynamics.types import AnyArray, Array
from flexarm_env.certify.motions import KINDS, Kind
from flexarm_env.compiled.termination import FLAGS
from flexarm_env.core import Core
from flexarm_env.scales import RIGID_PERIOD, Scales
from flexarm_env.tasks import TASKS

CHUNK = 4096  # states whose tips are computed together
TERMINATED = FLAGS.index("terminated")


@dataclass(frozen=True)
class Trace:
    """Tips of N episodes after each of T control steps."""

    tips: Array  # (T, N, 3) [m]
    valid: AnyArray  # (T, N) the episode has not ended


@dataclass(frozen=True)
class Episodes:
    """Starts and actions of episodes of several kinds."""

    kinds: tuple[str, ...]  # (N,) of each episode
    q: Array  # (N, n) start in the coordinates of `arm`
    v: Array  # (N, n)
    actions: Array  # (T, N, n_torque)
    arm: Arm
    seed: int = 0

    @classmethod
    def drawn(cls, core: Core, names: Sequence[str], count: int, steps: int) -> "Episodes":
        """`count` episodes of each kind for the arm and torques of an environment."""
        found, arm = core.scales, core.arm
        period = 2.0 * np.pi / found.free[0] if found.free else RIGID_PERIOD
        q, v, actions = [], [], []
        for name in names:
            rng = np.random.default_rng([0, sum(name.encode())])
            shape = (steps, count, arm.n_torque)
            shares = KINDS[name].actions(rng, shape, core.control_dt / period)
            start = _start(arm, found, KINDS[name], count, rng)
            q.append(start[0])
            v.append(start[1])
            actions.append(_with_holding(core, start[0], shares))
        kinds = tuple(name for name in names for _ in range(count))
        return cls(kinds, np.vstack(q), np.vstack(v), np.concatenate(actions, axis=1), arm)

    def of(self, rows: AnyArray) -> "Episodes":
        """Some of the episodes."""
        kinds = tuple(np.array(self.kinds)[rows].tolist())
        chosen = self.actions[:, rows]
        return Episodes(kinds, self.q[rows], self.v[rows], chosen, self.arm, self.seed)

    def played(self, core: Core, disturbance: float = 0.0) -> Trace:
        """Play the episodes on an environment of as many arms, of any model of the arm.

        Drawn parameters of episode i come from the seed `seed` + i. The first joint starts
        `disturbance` [rad] beside the start.
        """
        rows = np.arange(core.n_env)
        for row in rows.tolist():
            core.seed(row, seeding.np_random(self.seed + row)[0])
        q, v = transferred(self.q, self.v, self.arm, core.arm)
        q[:, core.arm.joint_index[0]] += disturbance
        core.reset(rows, {"state": {"q": q, "v": v}})
        states, valid = [], np.ones(core.n_env, dtype=bool)
        going = []
        for action in self.actions.astype(np.float32):
            out, _ = core.step(np.ascontiguousarray(action))
            valid &= ~out.flags[TERMINATED, : core.n_env].astype(bool)
            going.append(valid.copy())
            states.append(core.q.copy())
        tips = _tips(core, np.concatenate(states))
        return Trace(tips.reshape(len(states), core.n_env, 3), np.array(going))


@dataclass(frozen=True)
class Distances:
    """Tip distance between two traces until either ends."""

    largest: Array  # (T, N) [m] up to each time; NaN after the end of an episode
    kinds: tuple[str, ...]

    @classmethod
    def between(cls, a: Trace, b: Trace, kinds: tuple[str, ...]) -> "Distances":
        apart = np.linalg.norm(a.tips - b.tips, axis=2)
        largest = np.maximum.accumulate(np.where(a.valid & b.valid, apart, 0.0), axis=0)
        return cls(np.where(a.valid & b.valid, largest, np.nan), kinds)

    def of(self, kind: str) -> Array:
        """(T, n) of the episodes of a kind."""
        return self.largest[:, np.array(self.kinds) == kind]

    @cached_property
    def per_episode(self) -> Array:
        """(N,) [m] largest of each episode; zero of one that ends at once."""
        return np.nan_to_num(np.nanmax(np.vstack([self.largest, 0.0 * self.largest[:1]]), axis=0))

    def quantile(self, share: float) -> float:
        """[m] largest over the kinds of the quantile of their episodes."""
        names = np.array(self.kinds)
        values = [np.quantile(self.per_episode[names == kind], share) for kind in {*self.kinds}]
        return float(max(values))


def _start(arm: Arm, found: Scales, kind: Kind, count: int, rng: Any) -> tuple[Array, Array]:
    """(count, n) coordinates and rates of the starts of Reach, or of Damp if `kind.shaken`."""
    task = TASKS["Damp" if kind.shaken else "Reach"]
    joints = list(arm.joint_index)
    q, v = np.zeros((2, count, arm.n))
    q[:, : arm.base.n] = arm.base.q
    q[:, joints] = found.home + rng.uniform(*task.start, (count, arm.n_joint))
    modal = [i for i in range(arm.base.n, arm.n) if i not in joints]
    for x, shapes in ((q, found.vibration), (v, found.vibration_rate)):
        if kind.shaken and modal:
            share = rng.uniform(*task.shake, (count, len(shapes)))
            x[:, modal] = share @ np.reshape(shapes, (len(shapes), len(modal)))
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
    return Core(task="Reach", arm=arm, n_env=count, **keywords)
