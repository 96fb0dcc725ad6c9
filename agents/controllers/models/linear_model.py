"""Discrete linear models of an arm about rest at target postures, for model-based controllers.

The arm is that of the environment with one payload and one stiffness out of those that it draws; it
rests with straight links, so it must not bear gravity. With the matrices of
M a + C v + K q = B tau (`dynamics.formulations.linearized`) and the natural modes of M and K with
free joints, slow ones alone, q - target = S z. With x = (z, dz/dt) and inputs held over a control
step,

    x[k + 1] = A x[k] + B tau[k],   y[k + 1] = C x[k + 1] + D tau[k]: joint angles, then curvatures
                                                                      of the strain gauges.

A mode that turns by more than FASTEST within a control step cannot be controlled at that rate; it
is left out but for what the held torques bend of it, which D reads. The joint angles are among the
modes: with straight links they cost no energy.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy.linalg import eigh, expm

from agents.controllers.models.memory import kept
from dynamics import Arm, Model, Stepper, compile_arm
from dynamics.description.parameters import with_parameters
from dynamics.formulations.linearized import damping, stiffness
from dynamics.types import AnyArray, Array
from flexarm_env.task.observations import curvature_columns

ROUND = 4  # decimals [rad] within which postures share a model
FASTEST = 3.0  # [rad] per control step; beyond pi, samples take a mode for a slower one
KEPT = 4096  # models; the least recently used go
LEVELS = {"payload_mass": 7, "stiffness": 3}  # evenly over what is drawn, with both ends
BEYOND = 0.5  # share of what is drawn by which plants go beyond it on both sides
NOMINAL = {"payload_mass": 0.0, "stiffness": 1.0}

Range = tuple[float, float]


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Model of one plant at one posture: n coordinates, r modes, m joints, g gauges.

    Models are told apart by identity, so that what is derived of them can be cached by model.
    """

    A: Array  # (2r, 2r)
    B: Array  # (2r, m)
    C: Array  # (m + g, 2r)
    D: Array  # (m + g, m)
    tip: Array  # (3, r) [m] tip displacement per mode
    shapes: Array  # (n, r) S
    modes: Array  # (r, n) of a displacement: S' M
    K: Array  # (n, n)
    tip_of: Array  # (3, n) [m] tip displacement per coordinate
    readings: Array  # (m + g, n) y per coordinate
    bend: Array  # (2 links, r) [-] deflection along y and z over a link's length, per mode
    rest: Array  # (n,) target
    plant: int  # index of the plant


@dataclass(frozen=True)
class Plant:
    """An arm with one payload and one stiffness: M a + C v + K q = B tau."""

    model: Model
    payload: float  # [kg]
    factor: float  # of the stiffness
    K: Array  # (n, n)
    C: Array  # (n, n)


class LinearModels:
    """Linear models of an arm's plants at postures; the latest KEPT are kept.

    Attributes
    ----------
    drawn : least and largest payload [kg] and factor of the stiffness.
    levels : payloads and factors of a grid: LEVELS of what is drawn, and as densely beyond.
    plants : one of each payload and stiffness; `middle` is the index of the one in the middle of
        what is drawn.
    joints, modal : indices of the joints' and the modes' coordinates.
    """

    def __init__(self, arm: Arm, control_dt: float, drawn: tuple[tuple[str, Range], ...]) -> None:
        if any(arm.gravity):
            raise ValueError(
                f"Linear controllers take an arm without gravity, got gravity={arm.gravity}; "
                "use pd."
            )
        if arm.base.n:
            raise ValueError(
                f"Linear controllers take an arm on a fixed base, got {arm.base.type!r}; use pd."
            )
        spans = {name: (value, value) for name, value in NOMINAL.items()} | dict(drawn)
        self.drawn = [spans[name] for name in LEVELS]
        self.levels = list(map(_levels, self.drawn, LEVELS.values()))
        self.plants = _plants(arm, *self.levels)
        payload, factor = map(_middle, self.levels, self.drawn)
        self.middle = payload * len(self.levels[1]) + factor
        self.model = self.plants[self.middle].model
        self.control_dt = control_dt
        self.joints = list(self.model.arm.joint_index)
        self.modal = [i for i in range(self.model.n) if i not in self.joints]
        self._gauges = list(curvature_columns(arm))
        self._model = kept(self._linear_model, KEPT)
        self._seen = kept(self._geometry, KEPT)

    @staticmethod
    def of(env: Any) -> "LinearModels":
        """Models of an environment's arm; environments with equal arms share them."""
        core = env.unwrapped.core
        arm = with_parameters(core.arm, usual(core.randomize))
        drawn = tuple(sorted((name, x) for name, x in core.randomize.items() if name in LEVELS))
        return _shared(arm, core.control_dt, drawn)

    def at(self, posture: Array, plant: int | None = None) -> LinearModel:
        """Model at joint angles (m,) [rad], of the middle plant if none is named."""
        return self._model(place_of(posture), self.middle if plant is None else plant)

    def nearest(self, drawn: Array) -> AnyArray:
        """(N,) plants nearest to payloads [kg] and factors of the stiffness (N, 2)."""
        payload, factor = (
            np.abs(np.subtract.outer(values, level)).argmin(axis=1)
            for values, level in zip(drawn.T, self.levels, strict=True)
        )
        return payload * len(self.levels[1]) + factor

    def _linear_model(self, place: tuple[float, ...], plant_index: int) -> LinearModel:
        plant, m = self.plants[plant_index], self.model.n_joint
        q = self._straight(place)
        kept, tip, readings = self._seen(place)
        M = plant.model.mass_matrix(q)
        squares, every = eigh(plant.K, M)
        shapes, fast = every[:, :kept], every[:, kept:]
        modes = shapes.T @ M
        inputs = np.linalg.solve(M, self.forces)
        flow = np.zeros((2 * kept + m, 2 * kept + m))
        flow[:kept, kept : 2 * kept] = np.eye(kept)
        flow[kept : 2 * kept, :kept] = -shapes.T @ plant.K @ shapes
        flow[kept : 2 * kept, kept : 2 * kept] = -shapes.T @ plant.C @ shapes
        flow[kept : 2 * kept, 2 * kept :] = modes @ inputs
        step = expm(flow * self.control_dt)
        seen, bent = readings @ shapes, fast / squares[kept:] @ fast.T @ self.forces
        return LinearModel(
            A=step[: 2 * kept, : 2 * kept], B=step[: 2 * kept, 2 * kept :],
            C=np.hstack([seen, np.zeros_like(seen)]), D=readings @ bent, tip=tip @ shapes,
            shapes=shapes, modes=modes, K=plant.K, tip_of=tip, readings=readings,
            bend=self.bends @ shapes, rest=q, plant=plant_index,
        )  # fmt: skip

    def _straight(self, place: tuple[float, ...]) -> Array:
        """(n,) coordinates of the arm with straight links at joint angles."""
        q = np.zeros(self.model.n)
        q[self.joints] = place
        return q

    def _geometry(self, place: tuple[float, ...]) -> tuple[int, Array, Array]:
        """Number of slow modes, tip (3, n) and readings (m + g, n) per coordinate at a posture.

        The number is the middle plant's, so that the models of all plants are as large.
        """
        q = self._straight(place)
        squares = eigh(self.plants[self.middle].K, self.model.mass_matrix(q), eigvals_only=True)
        tip, curvature = self._measured(q)
        readings = np.concatenate([self.model.encoders, curvature])
        return int(np.sum(squares < (FASTEST / self.control_dt) ** 2)), tip, readings

    @cached_property
    def forces(self) -> Array:
        """(n, m) generalized forces of joint torques; parallel drives load more than one joint."""
        model, rest = self.model, np.zeros(self.model.n)
        columns = [model.accelerations(rest, rest, tau) for tau in np.eye(model.n_joint)]
        return model.mass_matrix(rest) @ np.column_stack(columns)

    @cached_property
    def bends(self) -> Array:
        """(2 links, n) deflections of the links' tips along y and z over their lengths."""
        model, rows = self.model, []
        for link, place in zip(model.arm.links, model.bodies, strict=True):
            bodies = model.chain.links[place]
            rest = np.cumsum([body.length for body in bodies[::-1]])[::-1]
            row = np.zeros((3, model.n))
            for i in self.modal:
                parts = model.chain.split(np.eye(model.n)[i].tolist())[place]
                for body, beyond, (_, delta) in zip(bodies, rest, parts, strict=True):
                    for amplitude, phi, theta in zip(
                        delta, body.tip_phi, body.tip_theta, strict=False
                    ):
                        turned = np.cross(theta, [beyond - body.length, 0.0, 0.0])
                        row[:, i] += amplitude * (np.array(phi) + turned)
            rows.append(row[1:] / (link.length or 1.0))
        return np.vstack(rows)

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


def usual(ranges: Mapping[str, Range]) -> dict[str, float]:
    """Middles of the ranges of drawn parameters of which there is no grid, such as friction."""
    return {name: sum(ends) / 2.0 for name, ends in ranges.items() if name not in LEVELS}


def place_of(posture: Array, decimals: int = ROUND) -> tuple[float, ...]:
    """Joint angles [rad] by which models are kept, rounded."""
    return tuple(round(angle, decimals) for angle in posture.tolist())


def _plants(arm: Arm, payloads: list[float], stiffnesses: list[float]) -> tuple[Plant, ...]:
    """Plants of every payload [kg] and factor of the stiffness."""
    models = [compile_arm(with_parameters(arm, {"payload_mass": payload})) for payload in payloads]
    return tuple(
        Plant(model, payload, factor, factor * stiffness(model.chain), damping(model.chain))
        for model, payload in zip(models, payloads, strict=True)
        for factor in stiffnesses
    )


def _levels(drawn: Range, count: int) -> list[float]:
    """Positive values evenly over what is drawn and beyond; the least drawn may be zero."""
    low, high = drawn
    if high <= low:
        return [low]
    beyond, step = round(BEYOND * (count - 1)), (high - low) / (count - 1)
    values = [low + k * step for k in range(-beyond, count + beyond)]
    return [value for value in values if value > 0.0 or value == low]


def _middle(levels: list[float], drawn: Range) -> int:
    """Index of the level in the middle of what is drawn."""
    return int(np.argmin(np.abs(np.array(levels) - sum(drawn) / 2.0)))
