"""Discrete linear models of an arm about rest at target postures, for model-based controllers.

The arm is that of the environment with the middle of every drawn range; it rests with straight
links, so it must not bear gravity. With x = (q - target, v), inputs held over a control step and
the matrices of M a + C v + K q = B tau (`dynamics.formulations.linearized`),

    x[k + 1] = A x[k] + B tau[k],   y = C x: joint angles, then curvatures of the strain gauges.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import expm

from dynamics import Arm, Model, Stepper, compile_arm
from dynamics.formulations.linearized import linear_arm
from dynamics.types import Array
from flexarm_env.observations import curvature_columns

ROUND = 9  # decimals [rad] within which postures share a model


@dataclass(frozen=True)
class LinearModel:
    """Model at one posture: n coordinates, m joints, g gauges."""

    A: Array  # (2n, 2n)
    B: Array  # (2n, m)
    C: Array  # (m + g, 2n)
    tip: Array  # (3, n) [m] tip displacement per coordinate
    M: Array  # (n, n)
    K: Array  # (n, n)


class LinearModels:
    """Linear models of an environment's arm, computed once per posture.

    Attributes
    ----------
    joints, modal : indices of the joints' and the modes' coordinates.
    """

    def __init__(self, env: Any) -> None:
        core = env.unwrapped.core
        self.model: Model = compile_arm(_middle(core.arm, core.randomize))
        if any(self.model.arm.gravity):
            raise ValueError(
                "Linear controllers take an arm without gravity, got "
                f"gravity={self.model.arm.gravity}; use pd."
            )
        self.control_dt = core.control_dt
        self.joints = list(self.model.arm.joint_index)
        self.modal = [i for i in range(self.model.n) if i not in self.joints]
        self._gauges = list(curvature_columns(self.model.arm))
        self._known: dict[tuple[float, ...], LinearModel] = {}

    def at(self, posture: Array) -> LinearModel:
        """Model at joint angles (m,) [rad]; without gravity the first does not matter."""
        key = tuple(np.round(posture[1:], ROUND).tolist())
        if key not in self._known:
            self._known[key] = self._linear_model(np.array([0.0, *key]))
        return self._known[key]

    def _linear_model(self, posture: Array) -> LinearModel:
        model, n = self.model, self.model.n
        q = np.zeros(n)
        q[self.joints] = posture
        linear = linear_arm(model.chain, q)
        rest = model.accelerations(q, np.zeros(n), np.zeros(model.n_joint))
        inputs = np.column_stack(
            [model.accelerations(q, np.zeros(n), tau) - rest for tau in np.eye(model.n_joint)]
        )
        inverse = np.linalg.inv(linear.M)
        m = model.n_joint
        flow = np.zeros((2 * n + m, 2 * n + m))
        flow[:n, n : 2 * n] = np.eye(n)
        flow[n : 2 * n, :n] = -inverse @ linear.K
        flow[n : 2 * n, n : 2 * n] = -inverse @ linear.C
        flow[n : 2 * n, 2 * n :] = inputs
        step = expm(flow * self.control_dt)
        tip, curvature = self._measured(q)
        C = np.zeros((m + len(self._gauges), 2 * n))
        C[range(m), self.joints] = 1.0
        C[m:, :n] = curvature
        return LinearModel(
            step[: 2 * n, : 2 * n], step[: 2 * n, 2 * n :], C, tip, linear.M, linear.K
        )

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


def _middle(arm: Arm, drawn: dict[str, tuple[float, float]]) -> Arm:
    """The arm with the middle of the ranges that an environment draws."""
    links = list(arm.links)
    if "payload_mass" in drawn:
        added = 0.5 * sum(drawn["payload_mass"])
        links[-1] = replace(links[-1], tip_mass=links[-1].tip_mass + added)
    return replace(arm, links=tuple(links))
