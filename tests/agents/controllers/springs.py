"""Masses on springs in place of an arm: for laws and filters nothing needs compiling."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.linalg import expm

from agents.controllers.models.linear_model import KEPT, LinearModels, Plant
from agents.controllers.models.memory import kept
from dynamics.types import Array

JOINTS, MODAL, N = [0, 2], [1, 3], 4
M = np.array(
    [[2.0, 0.3, 0.5, 0.1], [0.3, 0.4, 0.1, 0.05], [0.5, 0.1, 1.2, 0.2], [0.1, 0.05, 0.2, 0.3]]
)
K = np.diag([0.0, 40.0, 0.0, 90.0])
K[1, 3] = K[3, 1] = 8.0
C = np.diag([0.0, 0.3, 0.0, 0.5])
LOAD = np.array([0.5, 1.0, 0.4, 0.8])  # motion of the payload per coordinate
TIP = np.array([[0.1, 0.2, 0.3, 0.1], [0.9, 1.0, 0.4, 0.7], [0.0, 0.0, 0.0, 0.0]])
READINGS = np.array(
    [[1.0, 0.2, 0.0, 0.0], [0.0, 0.0, 1.0, 0.1], [0.0, 6.0, 0.0, 0.5], [0.0, 0.0, 0.0, 9.0]]
)
BENDS = np.array(
    [[0.0, 2.0, 0.0, 0.3], [0.0, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0, 1.5], [0.0, 0.0, 0.0, 0.0]]
)
DT, MOVE_TIME, REACH = 0.02, 1.5, 1.4
LIMIT, DEFLECTION = np.array([3.0, 0.8]), 0.1
SCALES = {
    "joint_error": [0.5, 0.6], "joint_rate": [2.0, 3.0],
    "modal_amplitude": [0.03, 0.02], "modal_rate": [0.4, 0.3],
    "root_curvature": [0.7, 0.9], "joint_sin": [1.0], "joint_cos": [1.0],
    "target_rate": [2.0, 3.0], "target_near": [0.5, 0.4], "target_far": [0.7, 0.6],
}  # fmt: skip
MOVING = ("target_rate", "target_near", "target_far")
HIDDEN = {"state": ("root_curvature",), "sensors": ("modal_amplitude", "modal_rate")}


class Springs(LinearModels):
    """Linear models of plants whose mass matrix is constant."""

    def __init__(self, payloads: Sequence[float], factors: Sequence[float], modes: int) -> None:
        self.levels = [list(payloads), list(factors)]
        self.drawn = [(min(x), max(x)) for x in self.levels]
        arms = [Mass(payload) for payload in payloads]
        self.plants = tuple(
            Plant(arm, payload, factor, factor * K, C)
            for arm, payload in zip(arms, payloads, strict=True)
            for factor in factors
        )
        self.middle = len(self.plants) // 2
        self.model = self.plants[self.middle].model
        self.control_dt, self.joints, self.modal = DT, JOINTS, MODAL
        self._model = kept(self._linear_model, KEPT)
        self._seen = lambda place: (modes, TIP, READINGS)
        self.forces, self.bends = np.eye(N)[:, JOINTS], BENDS


class Mass:
    """Constant masses, as a `dynamics.Model`."""

    n, n_joint, encoders = N, 2, READINGS[:2]

    def __init__(self, payload: float) -> None:
        self.M = M + payload * np.outer(LOAD, LOAD)

    def mass_matrix(self, q: Array) -> Array:
        return self.M

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        return a @ self.M + v @ C + q @ K

    def frequencies(self, q: Array, joints: str) -> Array:
        assert joints == "locked"
        ratio = np.linalg.solve(self.M[np.ix_(MODAL, MODAL)], K[np.ix_(MODAL, MODAL)])
        return np.sqrt(np.sort(np.linalg.eigvals(ratio).real))

    @property
    def arm(self) -> Any:
        return SimpleNamespace(joint_index=tuple(JOINTS), n_joint=2)


def step_of(plant: Plant) -> tuple[Array, Array]:
    """(2n, 2n) and (2n, m) of a control step of coordinates and rates."""
    inverse = np.linalg.inv(plant.model.mass_matrix(np.zeros(N)))
    flow = np.zeros((2 * N + 2, 2 * N + 2))
    flow[:N, N : 2 * N] = np.eye(N)
    flow[N : 2 * N] = inverse @ np.hstack([-plant.K, -plant.C, np.eye(N)[:, JOINTS]])
    step = expm(flow * DT)
    return step[: 2 * N, : 2 * N], step[: 2 * N, 2 * N :]


class Environment:
    """The masses as an environment, which is never stepped."""

    def __init__(
        self, obs: str = "state", *, moving: bool = False, hardware: Any = None,
        payloads: Sequence[float] = (0.0,), factors: Sequence[float] = (1.0,), modes: int = N,
    ) -> None:  # fmt: skip
        self.unwrapped, self.models = self, Springs(payloads, factors, modes)
        self.model, self.reach, self.torque_limit = self.models.model, REACH, LIMIT
        self.observation_slices: dict[str, slice] = {}
        self.observation_scales = {name: np.array(scale) for name, scale in SCALES.items()}
        self.size = 0
        for name, scale in self.observation_scales.items():
            if name not in HIDDEN[obs] and (moving or name not in MOVING):
                self.observation_slices[name] = slice(self.size, self.size + scale.size)
                self.size += scale.size
        self.single_observation_space = SimpleNamespace(shape=(self.size,))
        self.core = SimpleNamespace(
            arm=self.model.arm, control_dt=DT, move_time=MOVE_TIME, torque_limit=LIMIT,
            arguments={"deflection_limit": DEFLECTION}, randomize={}, gauge_scale=[0.7, 0.9],
            task=SimpleNamespace(moving=moving, shake=(0.1, 0.4)),
            sensing=SimpleNamespace(hardware=hardware) if hardware else None,
            scales=SimpleNamespace(
                locked=tuple(self.model.frequencies(np.zeros(N), "locked").tolist()),
                vibration=((0.03, 0.01), (0.005, 0.02)),
                vibration_rate=((0.3, 0.1), (0.1, 0.3)),
                modal_scale=SCALES["modal_amplitude"], modal_rate=SCALES["modal_rate"],
            ),
            integrator="midpoint", substeps=1,
        )  # fmt: skip

    def observed(self, **parts: Any) -> Array:
        """(N, size) observation of parts in physical units, (N, k); the others are zero."""
        count = max(len(np.atleast_2d(x)) for x in parts.values())
        x = np.zeros((count, self.size))
        for name, value in parts.items():
            x[:, self.observation_slices[name]] = value / self.observation_scales[name]
        return x


class Steppers:
    """`PlantSteppers` of the masses; the parameter of a plant is its index."""

    def __init__(self, core: Any, models: LinearModels, substeps: int | None = None) -> None:
        self.parameters = np.arange(len(models.plants), dtype=float)[:, None]
        self.steps = [step_of(plant) for plant in models.plants]

    def __call__(self, rows: int) -> "_Batch":
        return _Batch(self.steps, rows)

    def motions(self, plants: Array, state: Array, torques: Array) -> Array:
        found = []
        for torque in torques:
            pairs = [self.steps[p] for p in plants]
            state = np.array([
                A @ x + B @ u for (A, B), x, u in zip(pairs, state.T, torque.T, strict=True)
            ]).T  # fmt: skip
            found.append(state)
        return np.array(found)


class _Batch:
    def __init__(self, steps: list[tuple[Array, Array]], rows: int) -> None:
        self.steps, self.parameters = steps, np.zeros((rows, 1))
        self.q, self.v = np.zeros((2, rows, N))
        self.torque, self.status = np.zeros((rows, 2)), np.zeros(rows, int)

    def advance(self) -> None:
        x = np.hstack([self.q, self.v])
        for p, (A, B) in enumerate(self.steps):
            rows = self.parameters[:, 0] == p
            x[rows] = x[rows] @ A.T + self.torque[rows] @ B.T
        self.q[:], self.v[:] = np.split(x, 2, axis=1)
