"""Stiffness, damping and other free parameters of an arm, fitted to a log of its rig.

The arm starts at rest, straight, at the first reading of its encoders. It is stepped under the
logged command, and its free parameters minimise the squared residual of all signals. Every signal
is weighted by its own residual and may have a constant offset. Intervals are those of linear
regression: they assume that the residual is white noise, which `Fit.correlation` checks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as students_t

from dynamics.description import validate
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.load import ArmSource
from dynamics.measured.log_file import Log
from dynamics.model import Model, compile_arm
from dynamics.simulation.stepper import Stepper
from dynamics.types import Array

BOUNDS = {"stiffness": (0.2, 5.0), "damping": (0.0, 20.0)}  # times the arm's own
CONVERGED = 1e-3  # [of a signal's deviation] its change when the steps are halved
MOST_SUBSTEPS = 4096  # per sample
STARTS = 600  # points of the first search, on a grid over the bounds
TOGETHER = 64  # motions that are stepped together
DIFFERENCE = 1e-4  # [of the width of the bounds] half width of the differences
EDGE = 1e-6  # [of the width of the bounds] distance from a bound that counts as none
CONFIDENCE = 0.95
STRAIGHT = 1e-9  # [of the largest force] modal force at rest that counts as none

Bounds = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Gauge:
    """A strain gauge that reads the bending of a link in its x-y plane."""

    link: int  # counted from 0
    x: float  # [m] from the joint
    distance: float = 1.0  # [m] from the neutral axis; 1 for a log of curvatures [1/m]


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Fitted parameters with their intervals, and the signals beside the measured ones."""

    bounds: dict[str, tuple[float, float]]  # by parameter, in the order of the arrays below
    values: Array  # (p,) times the arm's own; a payload [kg]
    intervals: Array  # (p, 2) of CONFIDENCE, each parameter by itself
    covariance: Array  # (p, p)
    signals: tuple[str, ...]  # names of the c signals
    measured: Array  # (N, c) [rad], [m], [1/m] or [-]
    nominal: Array  # (N, c) of the arm as described, offsets taken away
    fitted: Array  # (N, c) offsets taken away
    correlation: Array  # (c,) of a residual's neighbours; 0 if white

    @property
    def at_bound(self) -> list[str]:
        """Parameters that stopped at a bound, whose intervals mean nothing."""
        low, high = np.array(list(self.bounds.values())).T
        near = np.minimum(self.values - low, high - self.values) < EDGE * (high - low)
        return [name for name, is_near in zip(self.bounds, near, strict=True) if is_near]

    def rms(self, signals: Array) -> Array:
        """(c,) root mean square of the difference between signals (N, c) and measured ones."""
        return np.sqrt(np.mean((signals - self.measured) ** 2, axis=0))

    def to_dict(self) -> dict[str, Any]:
        """Parameters, intervals and residuals as plain numbers."""
        return {
            "parameters": {
                name: {"value": x, "interval": pair, "bounds": list(self.bounds[name])}
                for name, x, pair in zip(
                    self.bounds, self.values.tolist(), self.intervals.tolist(), strict=True
                )
            },
            "at_bound": self.at_bound,
            "covariance": self.covariance.tolist(),
            "signals": {
                name: {"rms_nominal": before, "rms_fitted": after, "correlation": rho}
                for name, before, after, rho in zip(
                    self.signals, self.rms(self.nominal).tolist(), self.rms(self.fitted).tolist(),
                    self.correlation.tolist(), strict=True,
                )
            },
        }  # fmt: skip


class LoggedMotion:
    """Signals of an arm under the command of a log, for many values of its free parameters.

    Parameters
    ----------
    model : an arm compiled with free parameters, on a fixed base.
    """

    def __init__(self, model: Model, log: Log, gauges: Sequence[Gauge]) -> None:
        arm = model.arm
        if arm.base.n:
            raise ValueError(f"A fit needs a fixed base, got Base.type {arm.base.type!r}.")
        for signals, count, noun in (
            (log.command, model.n_torque, "commands"),
            (log.encoder, model.n_joint, "encoders"),
            (log.gauge, len(gauges), "gauge columns"),
        ):
            if signals.shape[1] != count:
                raise ValueError(f"The arm needs {count} {noun}, got {signals.shape[1]}.")
        self.model, self.log, self.substeps = model, log, 1
        self.measured = np.hstack([log.encoder, log.gauge])
        self.deviation = np.maximum(self.measured.std(axis=0), np.finfo(float).tiny)
        unit = np.eye(model.n)
        joints = unit[list(arm.joint_index)]
        bends = [[g.distance * model.strain(x, g.link, g.x)[2] for x in unit] for g in gauges]
        self.rows = np.vstack([joints, np.reshape(bends, (-1, model.n))])  # (c, n) signals of q
        self.start = np.zeros(model.n)
        self.start[list(arm.joint_index)] = log.encoder[0]
        h = np.delete(model.bias(self.start, 0.0 * self.start), list(arm.joint_index))
        if np.abs(h).max(initial=0.0) > STRAIGHT:
            raise ValueError(
                "Gravity bends this arm at the first sample; a fit needs one that rests straight."
            )

    def signals(self, parameters: Array) -> Array:
        """(P, N, c) signals for parameters (P, p); NaN after a motion has diverged."""
        return np.concatenate([
            self._signals(parameters[k : k + TOGETHER]) for k in range(0, len(parameters), TOGETHER)
        ])  # fmt: skip

    def _signals(self, parameters: Array) -> Array:
        stepper = Stepper(self.model, len(parameters), dt=1.0, substeps=self.substeps)
        stepper.q[:], stepper.parameters[:] = self.start, parameters
        states = np.empty((len(self.log.time), *stepper.q.shape))
        states[0] = stepper.q
        steps = np.diff(self.log.time) / self.substeps
        failed = np.zeros(len(parameters), dtype=bool)
        for k, dt in enumerate(steps.tolist()):
            stepper.dt = dt
            stepper.torque[:] = self.log.command[k]
            stepper.advance()
            states[k + 1] = stepper.q
            failed |= stepper.status > 0
        states[:, failed] = np.nan
        return np.swapaxes(states @ self.rows.T, 0, 1)

    def refine(self, parameters: Array) -> None:
        """Double the substeps per sample until the signals of all parameters (P, p) converge."""
        before = self.signals(parameters)
        while True:
            if self.substeps >= MOST_SUBSTEPS:
                raise ValueError(
                    f"The arm does not converge with {self.substeps} steps per sample; give "
                    "narrower bounds, fewer modes or a log with more samples."
                )
            self.substeps *= 2
            after = self.signals(parameters)
            change = np.abs(after - before).max(axis=(0, 1)) / self.deviation
            if np.all(change <= CONVERGED):  # False for NaN
                return
            before = after


def fit(
    arm: ArmSource, log: Log, gauges: Sequence[Gauge] = (), bounds: Bounds | None = None
) -> Fit:
    """Fit free parameters of an arm, names in FREE_PARAMETERS, within bounds to a log.

    Parameters
    ----------
    arm : an Arm, a preset's name, a path or a dict, as `load_arm` accepts.
    gauges : places of the log's gauge columns.
    bounds : (low, high) by parameter; default BOUNDS.

    Raises
    ------
    ValueError : for an arm, gauges or bounds that do not fit the log, and for a parameter that no
        signal depends on.
    """
    within = checked_bounds(BOUNDS if bounds is None else bounds)
    motion = LoggedMotion(compile_arm(arm, free_parameters=list(within)), log, gauges)
    low, high = np.array(list(within.values())).T
    motion.refine(np.array(list(product(*within.values()))))
    nominal = np.array([FREE_PARAMETERS[name].nominal for name in within])
    tried = np.vstack([nominal, _grid(within)])
    errors = np.array([
        _squares(motion, one) for k in range(0, len(tried), TOGETHER)
        for one in motion.signals(tried[k : k + TOGETHER])
    ])  # fmt: skip
    inside = ((tried >= low) & (tried <= high)).all(axis=1)
    x = tried[np.argmin(np.where(inside, errors, np.inf))]
    weights = 1.0 / motion.deviation
    for _ in range(3):  # weights from the residual before
        x, residual, slopes = _solve(motion, x, low, high, weights)
        weights = 1.0 / np.maximum(residual.std(axis=0), 1e-12 * motion.deviation)
    weak = [name for name, column in zip(within, slopes.T, strict=True) if not column.any()]
    if weak:
        raise ValueError(
            f"{weak[0]} has no effect on these signals; give the arm a nominal {weak[0]} to scale, "
            "or leave it out of the fit."
        )
    weighted = (residual * weights).ravel()
    freedom = weighted.size - x.size - weights.size
    try:
        covariance = np.linalg.inv(slopes.T @ slopes) * (weighted @ weighted) / freedom
    except np.linalg.LinAlgError:
        raise ValueError(
            f"These signals do not tell {list(within)} apart; fit fewer of them."
        ) from None
    half = students_t.ppf(0.5 + 0.5 * CONFIDENCE, freedom) * np.sqrt(np.diag(covariance))
    before, after = motion.signals(np.vstack([nominal, x]))
    return Fit(
        bounds=within,
        values=x,
        intervals=np.stack([x - half, x + half], axis=1),
        covariance=covariance,
        signals=(
            *(f"encoder {k + 1}" for k in range(log.encoder.shape[1])),
            *(f"gauge {k + 1}" for k in range(log.gauge.shape[1])),
        ),
        measured=motion.measured,
        nominal=before - _mean(before - motion.measured),
        fitted=after - _mean(after - motion.measured),
        correlation=np.sum(residual[1:] * residual[:-1], axis=0) / np.sum(residual**2, axis=0),
    )


def checked_bounds(bounds: Bounds) -> dict[str, tuple[float, float]]:
    """Bounds (low, high) by free parameter; a ValueError for others, and for empty ranges."""
    if not bounds:
        raise ValueError(f"A fit needs at least one of the parameters {list(FREE_PARAMETERS)}.")
    result = {}
    for name, pair in bounds.items():
        validate.known(name, "parameter", FREE_PARAMETERS)
        low, high = validate.numbers(pair, f"bounds of {name}", 2)
        if not 0.0 <= low < high:
            raise ValueError(
                f"bounds of {name} must be (low, high) with 0 <= low < high, "
                f"got {validate.shown(pair)}."
            )
        result[name] = (low, high)
    return result


def _grid(within: Bounds) -> Array:
    """(P, p) points over the bounds, at equal ratios where no bound is zero."""
    count = round(STARTS ** (1.0 / len(within)))
    axes = (np.geomspace(*b, count) if b[0] else np.linspace(*b, count) for b in within.values())
    return np.array(list(product(*axes)))


def _mean(difference: Array) -> Array:
    """Offsets (..., 1, c) of signals (..., N, c)."""
    return difference.mean(axis=-2, keepdims=True)


def _squares(motion: LoggedMotion, signals: Array) -> float:
    difference = signals - motion.measured
    return float(np.sum(((difference - _mean(difference)) / motion.deviation) ** 2))


def _solve(
    motion: LoggedMotion, x: Array, low: Array, high: Array, weights: Array
) -> tuple[Array, Array, Array]:
    """Best parameters (p,), their residual (N, c) and its weighted Jacobian (N c, p)."""
    half = DIFFERENCE * (high - low)

    def residual(x: Array) -> Array:
        difference = motion.signals(x[None])[0] - motion.measured
        result: Array = difference - _mean(difference)
        return result

    def jacobian(x: Array) -> Array:
        """Central differences; a point may stand half a width outside the bounds, but above 0."""
        middle = np.maximum(x, half)
        points = np.vstack([middle + np.diag(half), middle - np.diag(half)])
        above, below = np.split(motion.signals(points), 2)
        slopes = (above - below) / (2.0 * half[:, None, None])
        result: Array = ((slopes - _mean(slopes)) * weights).reshape(x.size, -1).T
        return result

    found = least_squares(
        lambda x: (residual(x) * weights).ravel(), np.clip(x, low, high), jacobian,
        bounds=(low, high), x_scale=high - low, xtol=1e-10, ftol=1e-12,
    )  # fmt: skip
    return found.x, residual(found.x), jacobian(found.x)
