"""What a policy sees: which signals, in which units, within which bounds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arm import Arm
from flexarm_env.physics import MOVE, Physics
from flexarm_env.tasks import Task

Array = NDArray[np.float64]

BOUND = 10.0  # [-] every scaled element is clipped to this
MODES = ("state", "sensors")


@dataclass(frozen=True)
class Part:
    """A named run of observation elements."""

    name: str
    meaning: str
    unit: str
    signals: tuple[int, ...]  # where the kernels keep them
    scale: tuple[float, ...]  # physical = observation * scale
    bound: float = BOUND


@dataclass(frozen=True)
class Layout:
    """An observation: its parts in order."""

    parts: tuple[Part, ...]
    n_signal: int  # signals the kernels prepare

    @property
    def picks(self) -> NDArray[np.uint64]:
        """(n,) per element: its signal."""
        return np.array([k for part in self.parts for k in part.signals], dtype=np.uint64)

    @property
    def table(self) -> Array:
        """(2, n) per element: factor to the observation, bound."""
        rows = [(1.0 / scale, part.bound) for part in self.parts for scale in part.scale]
        return np.array(rows).T.copy()

    @property
    def slices(self) -> dict[str, slice]:
        """Where each part is."""
        stops = np.cumsum([len(part.signals) for part in self.parts]).tolist()
        return {
            part.name: slice(stop - len(part.signals), stop)
            for part, stop in zip(self.parts, stops, strict=True)
        }

    @property
    def scales(self) -> dict[str, Array]:
        """Factors from observation to physical units."""
        return {part.name: np.array(part.scale) for part in self.parts}


def curvature_columns(arm: Arm) -> tuple[int, ...]:
    """Columns of the stepper's "curvature" that can differ from zero: the strain gauges."""
    return tuple(
        2 * i + k
        for i, link in enumerate(arm.links)
        for k, direction in enumerate("yz")
        if link.in_direction(direction)
    )


def is_planar(arm: Arm) -> bool:
    """Whether everything stays in the plane of the first joint."""
    parallel = all(link.joint.rotation[2][2] == 1.0 for link in arm.links[1:])
    flat = all(link.joint.offset[2] == 0.0 for link in arm.links[1:])
    bending = all(mode.direction == "y" for link in arm.links for mode in link.modes)
    return parallel and flat and bending


def observation_layout(arm: Arm, task: Task, kind: str, physics: Physics, rate: float) -> Layout:
    """The observation of an arm at a task; `rate` [rad/s] is the joint rate of a typical move."""
    if kind not in MODES:
        raise ValueError(f"obs must be one of {list(MODES)}, got {kind!r}.")
    m, n = arm.n_joint, arm.n
    columns = curvature_columns(arm)
    sizes = {
        "joint_error": m, "joint_rate": m, "action": m, "sine": m, "cosine": m, "q": n, "v": n,
        "tip_error": 3, "curvature": len(columns), "target_rate": m, "near": m, "far": m,
    }  # fmt: skip
    starts = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
    modal = [i for i in range(n) if i not in arm.joint_index]
    axes = [k for k in range(3) if (k != 0 or m > 1) and (k != 2 or not is_planar(arm))]
    turned = range(0 if any(arm.gravity) else 1, m)  # the first joint only matters under gravity

    def at(name: str, entries: "list[int] | range") -> tuple[int, ...]:
        return tuple(starts[name] + k for k in entries)

    def each(value: float, entries: "list[int] | range") -> tuple[float, ...]:
        return tuple(value for _ in entries)

    joints, gauges = range(m), range(len(columns))
    every = [
        Part("joint_error", "joint angle minus its target", "rad", at("joint_error", joints),
             each(MOVE, joints)),
        Part("joint_sin", "sine of the joint angle", "-", at("sine", turned), each(1.0, turned),
             1.0),
        Part("joint_cos", "cosine of the joint angle", "-", at("cosine", turned), each(1.0, turned),
             1.0),
        Part("joint_rate", "joint rate", "rad/s", at("joint_rate", joints), each(rate, joints)),
    ]  # fmt: skip
    if kind == "state":
        every += [
            Part("modal_amplitude", "modal amplitude", "m", at("q", modal), physics.modal_scale),
            Part("modal_rate", "modal rate", "m/s", at("v", modal), physics.modal_rate),
            Part("tip_error", "target minus tip, along the first link's undeformed axes "
                 f"({', '.join('xyz'[k] for k in axes)})", "m", at("tip_error", axes),
                 each(MOVE * arm.reach, axes)),
        ]  # fmt: skip
    else:
        every.append(
            Part("root_curvature", "curvature at the root of the link, as a strain gauge sees it",
                 "1/m", at("curvature", gauges), curvature_scale(arm, columns))
        )  # fmt: skip
    if task.moving:
        every += [
            Part("target_rate", "rate of the target joint angle", "rad/s",
                 at("target_rate", joints), each(rate, joints)),
            Part("target_near", "target joint angle half a typical move ahead, minus now", "rad",
                 at("near", joints), each(MOVE, joints)),
            Part("target_far", "target joint angle a typical move ahead, minus now", "rad",
                 at("far", joints), each(MOVE, joints)),
        ]  # fmt: skip
    every.append(
        Part("last_action", "the action before", "-", at("action", joints), each(1.0, joints), 1.0)
    )
    parts = tuple(part for part in every if part.signals)
    return Layout(parts, sum(sizes.values()))


def curvature_scale(arm: Arm, columns: tuple[int, ...]) -> tuple[float, ...]:
    """[1/m] root curvature under a tip force that deflects the link by 10 % of its length."""
    return tuple(3.0 * 0.1 / arm.links[c // 2].length for c in columns)
