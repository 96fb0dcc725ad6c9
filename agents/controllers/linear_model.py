"""Discrete linear models of an arm about rest at target postures, for model-based controllers.

The arm is that of the environment with the middle of every drawn range; it rests with straight
links, so it must not bear gravity. With the matrices of M a + C v + K q = B tau
(`dynamics.formulations.linearized`) and the natural modes of M and K with free joints, slow ones
alone, q - target = S z. With x = (z, dz/dt) and inputs held over a control step,

    x[k + 1] = A x[k] + B tau[k],   y = C x: joint angles, then curvatures of the strain gauges.

A mode that turns by more than FASTEST within a control step cannot be controlled at that rate; it
is left out. The joint angles are among the modes: with straight links they cost no energy.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import eigh, expm

from dynamics import Arm, Model, Stepper, compile_arm
from dynamics.formulations.linearized import linear_arm
from dynamics.types import Array
from flexarm_env.observations import curvature_columns

ROUND = 4  # decimals [rad] within which postures share a model
FASTEST = 3.0  # [rad] per control step; beyond pi, samples take a mode for a slower one


@dataclass(frozen=True)
class LinearModel:
    """Model at one posture: n coordinates, r modes, m joints, g gauges."""

    A: Array  # (2r, 2r)
    B: Array  # (2r, m)
    C: Array  # (m + g, 2r)
    tip: Array  # (3, r) [m] tip displacement per mode
    shapes: Array  # (n, r) S
    modes: Array  # (r, n) of a displacement: S' M
    M: Array  # (n, n)
    K: Array  # (n, n)
    tip_of: Array  # (3, n) [m] tip displacement per coordinate


class LinearModels:
    """Linear models of an arm, computed once per posture.

    Attributes
    ----------
    joints, modal : indices of the joints' and the modes' coordinates.
    """

    def __init__(self, arm: Arm, control_dt: float) -> None:
        self.model: Model = compile_arm(arm)
        if any(self.model.arm.gravity):
            raise ValueError(
                "Linear controllers take an arm without gravity, got "
                f"gravity={self.model.arm.gravity}; use pd."
            )
        self.control_dt = control_dt
        self.joints = list(self.model.arm.joint_index)
        self.modal = [i for i in range(self.model.n) if i not in self.joints]
        self._gauges = list(curvature_columns(self.model.arm))
        self._known: dict[tuple[float, ...], LinearModel] = {}

    @staticmethod
    def of(env: Any) -> "LinearModels":
        """Models of an environment's arm; environments with equal arms share them."""
        core = env.unwrapped.core
        return _shared(_middle(core.arm, core.randomize), core.control_dt)

    def at(self, posture: Array) -> LinearModel:
        """Model at joint angles (m,) [rad]; without gravity the first does not matter."""
        key = tuple(np.round(posture[1:], ROUND).tolist())
        if key not in self._known:
            self._known[key] = self._linear_model(np.array([0.0, *key]))
        return self._known[key]

    def _linear_model(self, posture: Array) -> LinearModel:
        model, n, m = self.model, self.model.n, self.model.n_joint
        q = np.zeros(n)
        q[self.joints] = posture
        linear = linear_arm(model.chain, q)
        rest = model.accelerations(q, np.zeros(n), np.zeros(m))
        inputs = np.column_stack(
            [model.accelerations(q, np.zeros(n), tau) - rest for tau in np.eye(m)]
        )
        squares, shapes = eigh(linear.K, linear.M)
        slow = squares < (FASTEST / self.control_dt) ** 2
        squares, shapes = squares[slow], shapes[:, slow]
        modes, r = shapes.T @ linear.M, len(squares)
        flow = np.zeros((2 * r + m, 2 * r + m))
        flow[:r, r : 2 * r] = np.eye(r)
        flow[r : 2 * r, :r] = -shapes.T @ linear.K @ shapes
        flow[r : 2 * r, r : 2 * r] = -shapes.T @ linear.C @ shapes
        flow[r : 2 * r, 2 * r :] = modes @ inputs
        step = expm(flow * self.control_dt)
        tip, curvature = self._measured(q)
        readings = np.concatenate([np.eye(n)[self.joints], curvature]) @ shapes
        return LinearModel(
            A=step[: 2 * r, : 2 * r], B=step[: 2 * r, 2 * r :],
            C=np.hstack([readings, np.zeros_like(readings)]), tip=tip @ shapes, shapes=shapes,
            modes=modes, M=linear.M, K=linear.K, tip_of=tip,
        )  # fmt: skip

    def _measured(self, q: Array) -> tuple[Array, Array]:
        """(3, n) tip and (g, n) curvature per coordinate."""
        model, n = self.model, self.model.n
        stepper = Stepper(model, n, dt=self.control_dt, substeps=1)
        out = np.zeros((n, model.n_measure))
        stepper.measure(np.tile(q, (n, 1)), np.eye(n), out)
        tip = out[:, model.measurements["tip_velocity"]].T.copy()
        bent = np.zeros((n, n))
        bent[self.modal, self.modal] = 1.0
        stepper.measure(bent, np.zeros((n, n)), out)
        return tip, out[:, model.measurements["curvature"]].T[self._gauges]


_shared = lru_cache(maxsize=8)(LinearModels)


def _middle(arm: Arm, drawn: dict[str, tuple[float, float]]) -> Arm:
    """The arm with the middle of the ranges that an environment draws."""
    links = list(arm.links)
    if "payload_mass" in drawn:
        added = 0.5 * sum(drawn["payload_mass"])
        links[-1] = replace(links[-1], tip_mass=links[-1].tip_mass + added)
    return replace(arm, links=tuple(links))
