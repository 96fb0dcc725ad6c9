"""Stiffness, damping and other parameters of an arm and its sensors, fitted to a log of its rig.

The arm is stepped under the logged command from the state in which the log starts, which is
estimated too, or measured. Parameters and start minimise the squared residual of all signals. Every
signal is weighted by its own residual and may have a constant offset. Intervals are those of linear
regression: they assume that the residual is white noise, which `Fit.correlation` checks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as students_t

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.load import ArmSource, load_arm
from dynamics.measured.least_squares import STARTS, search, solve
from dynamics.measured.log_file import Log
from dynamics.measured.motion import LoggedMotion
from dynamics.measured.sensors import Gauge as Gauge  # of the arguments of `fit`
from dynamics.measured.sensors import LinkAngle as LinkAngle
from dynamics.measured.sensors import Sensor
from dynamics.measured.sensors import TipSlope as TipSlope
from dynamics.measured.unknowns import Bounds, without_friction
from dynamics.progress import Progress
from dynamics.types import Array

BOUNDS = {"stiffness": (0.2, 5.0), "damping": (0.0, 20.0)}  # times the arm's own
STEP_ERROR = 1.5  # [deviations of noise, per root of samples] a tenth of those of the parameters
EDGE = 1e-6  # [of the width of the bounds] distance from a bound that counts as none
CONFIDENCE = 0.95
CHANCE = 1e-6  # that noise alone looks like a motion
SMOOTH = 0.5  # correlation of a signal's neighbours that noise alone does not have
APART = 1e-5  # [-] least sine of the angle between what two parameters do to the signals


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Fitted parameters with their intervals, and the signals beside the measured ones."""

    bounds: dict[str, tuple[float, float]]  # by parameter, in the order of the arrays below
    values: Array  # (p,) times the arm's own; a payload [kg]
    intervals: Array  # (p, 2) of CONFIDENCE, each parameter by itself
    covariance: Array  # (p, p)
    signals: tuple[str, ...]  # names of the c signals
    measured: Array  # (N, c) [rad], [m], [1/m] or [-]; NaN where there is no reading
    nominal: Array  # (N, c) of the arm as described, offsets taken away
    fitted: Array  # (N, c) offsets taken away
    correlation: Array  # (c,) of a residual's neighbours; 0 if white
    start: dict[str, tuple[float, float]]  # by coordinate, its value and its rate at the start
    arm: Arm  # as described

    @property
    def at_bound(self) -> list[str]:
        """Parameters that stopped at a bound, whose intervals mean nothing."""
        low, high = np.array(list(self.bounds.values())).T
        near = np.minimum(self.values - low, high - self.values) < EDGE * (high - low)
        return [name for name, is_near in zip(self.bounds, near, strict=True) if is_near]

    @property
    def untold(self) -> list[str]:
        """Parameters that the log does not tell: their intervals are wider than their bounds."""
        low, high = np.array(list(self.bounds.values())).T
        wide = np.ptp(self.intervals, axis=1) > high - low
        return [name for name, is_wide in zip(self.bounds, wide, strict=True) if is_wide]

    def environment(self) -> dict[str, Any]:
        """Keywords of an environment of the fitted arm: `arm`, and `randomize` over intervals.

        Torques, gains, delays and lags belong to the rig's motors and sensors, not to its arm.
        """
        ranges = {
            name: (max(low, least), min(high, most))
            for (name, (low, high)), (least, most) in zip(
                self.bounds.items(), self.intervals.tolist(), strict=True
            ) if name in FREE_PARAMETERS
        }  # fmt: skip
        return {"arm": without_friction(self.arm, ranges).to_dict(), "randomize": ranges}

    def rms(self, signals: Array) -> Array:
        """(c,) root mean square of the difference between signals (N, c) and measured ones."""
        result: Array = np.sqrt(np.nanmean((signals - self.measured) ** 2, axis=0))
        return result

    def explained(self, signals: Array) -> Array:
        """(c,) share of the variance of the measured signals that signals (N, c) explain."""
        result: Array = 1.0 - (self.rms(signals) / np.nanstd(self.measured, axis=0)) ** 2
        return result

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
            "environment": self.environment(),
            "start": {name: list(pair) for name, pair in self.start.items()},
            "covariance": self.covariance.tolist(),
            "signals": {
                name: {
                    "rms_nominal": before, "rms_fitted": after, "explained": share,
                    "correlation": rho,
                }
                for name, before, after, share, rho in zip(
                    self.signals, self.rms(self.nominal).tolist(), self.rms(self.fitted).tolist(),
                    self.explained(self.fitted).tolist(), self.correlation.tolist(), strict=True,
                )
            },
        }  # fmt: skip


def fit(
    arm: ArmSource,
    log: Log,
    gauges: Sequence[Sensor] = (),
    bounds: Bounds | None = None,
    *,
    start: str = "estimated",
    held: Mapping[int, float | None] | None = None,
    shooting: float | None = None,
    progress: bool | None = None,
) -> Fit:
    """Fit parameters of a rig within bounds to a log.

    Parameters
    ----------
    arm : an Arm, a preset's name, a path or a dict, as `load_arm` accepts.
    gauges : sensors of the log's gauge columns.
    bounds : (low, high) by parameter; default BOUNDS. Parameters are the names in FREE_PARAMETERS,
        where `viscous_1` [N m s/rad] and `coulomb_1` [N m] are all friction of a joint; `torque_1`
        times the logged torque of a joint; and of a signal `gain_gauge_1`, `delay_gauge_1` [s] and
        `lag_gauge_1` [s], the time constant of a low pass of second order, critically damped.
    start : "estimated": deflections and rates at the first sample are fitted too. "rest": the arm
        starts straight and at rest. "measured": as encoders and gauges read, smoothed.
    held : by joint, counted from 0, that cannot move, its angle [rad] or place [m]; None: the mean
        of its encoder, or 0 without one. The log may leave out command and encoder of held joints.
    shooting : [s] after which the motion starts again as measured, so that no drift grows.
    progress : True shows a line of progress on standard error; None only on a terminal.

    Raises
    ------
    ValueError : for an arm, gauges or bounds that do not fit the log, for a log in which nothing
        moves, and for a parameter that no signal depends on.
    """
    within = checked_bounds(BOUNDS if bounds is None else bounds)
    motion = LoggedMotion(arm, log, gauges, within, start=start, held=held, shooting=shooting)
    table = motion.unknowns
    weights = 1.0 / motion.deviation
    count = motion.present.sum(axis=0)
    with Progress(progress) as motion.line:
        motion.line.stage("search")
        x = search(motion, within)
        motion.line.stage("solution")
        for _ in range(3):  # weights from the residual before
            motion.refine(x[None], error=STEP_ERROR / weights / np.sqrt(len(log.time)))
            x, residual, slopes = solve(motion, x, weights)
            spread = np.sqrt(np.sum(residual**2, axis=0) / count)
            weights = 1.0 / np.maximum(spread, 1e-12 * motion.deviation)
    as_described = np.where(table.asked, table.nominal, x)
    before, after = motion.signals(np.vstack([as_described, x]))
    _check_motion(motion, after, weights)
    values, known = x[table.asked], table.precision(weights)
    covariance, start_freedom = _covariance(slopes, known, table.asked, list(within))
    weighted = (residual * weights).ravel()
    freedom = int(count.sum()) - values.size - weights.size - start_freedom
    covariance = covariance * (weighted @ weighted) / freedom
    half = students_t.ppf(0.5 + 0.5 * CONFIDENCE, freedom) * np.sqrt(np.diag(covariance))
    q, v = motion.state(x)
    measured = np.where(motion.present, motion.measured, np.nan)
    return Fit(
        bounds=within,
        values=values,
        intervals=np.stack([values - half, values + half], axis=1),
        covariance=covariance,
        signals=tuple(motion.names),
        measured=measured,
        nominal=before - np.nanmean(before - measured, axis=0),
        fitted=after - np.nanmean(after - measured, axis=0),
        correlation=_correlation(np.where(motion.present, residual, np.nan)),
        start=dict(zip(motion.model.names, zip(q.tolist(), v.tolist(), strict=True), strict=True)),
        arm=load_arm(arm),
    )


def _check_motion(motion: LoggedMotion, fitted: Array, weights: Array) -> None:
    """Refuse a log whose fitted motion may be noise."""
    strength = float(np.sum(((fitted - fitted.mean(axis=0)) * weights) ** 2))
    if strength > chi2.isf(CHANCE / STARTS, motion.unknowns.nominal.size):
        return
    centred = motion.measured - np.nanmean(motion.measured, axis=0)
    smooth = zip(motion.names, _correlation(centred) > SMOOTH, strict=True)
    moving = [name for name, is_smooth in smooth if is_smooth]
    driven = bool(motion.command.any())
    if moving:
        remedies = ["check the units of the log", "hold joints that were clamped"]
        remedies += [] if driven else ["give the torque if there was one"]
        remedies += ["let the start be estimated"] if motion.unknowns.asked.all() else []
        raise ValueError(
            f"No motion of this arm resembles {', '.join(moving)}; {', '.join(remedies)}, or "
            "widen the bounds."
        )
    if driven:
        raise ValueError(
            "The torque moves these signals less than their noise; log a larger motion, or name "
            "other columns."
        )
    raise ValueError(
        "Nothing moves in this log: the torque is zero throughout, and the signals show no start "
        "in motion beyond their noise; give the torque if there was one, or log a free decay from "
        "its release on."
    )


def _covariance(slopes: Array, known: Array, asked: Array, names: list[str]) -> tuple[Array, float]:
    """Covariance (p, p) of the parameters for noise of 1, and degrees of freedom of the start.

    The start's part of the weighted Jacobian (N c, k) is eliminated. `known` (k,) is 1 / deviation
    of what is known beforehand.
    """
    weak = [name for name, column in zip(names, slopes[:, asked].T, strict=True)
            if not column.any()]  # fmt: skip
    if weak:
        raise ValueError(
            f"{weak[0]} has no effect on these signals: they do not read what it changes; name a "
            f"signal that does, or leave {weak[0]} out of the fit."
        )
    rows = np.vstack([slopes, np.diag(known)])
    scaled = rows / np.linalg.norm(rows, axis=0)
    basis = np.linalg.qr(scaled[:, np.logical_not(asked)])[0]
    own = scaled[:, asked] - basis @ (basis.T @ scaled[:, asked])
    if np.linalg.svd(own, compute_uv=False)[-1] < APART:
        also = " and the start" if basis.size else ""
        raise ValueError(f"These signals do not tell {names}{also} apart; fit fewer of them.")
    size = np.linalg.norm(rows[:, asked], axis=0)
    covariance = np.linalg.inv(own.T @ own) / np.outer(size, size)
    # of a direction of the start, the part that the signals know, not what was known beforehand
    return covariance, float(np.sum(basis[: len(slopes)] ** 2))


def _correlation(signals: Array) -> Array:
    """(c,) correlation of the neighbours in signals (N, c) of mean zero, between gaps of NaN."""
    columns = [column[np.isfinite(column)] for column in signals.T]
    return np.array([column[1:] @ column[:-1] / (column @ column) for column in columns])


def checked_bounds(bounds: Bounds) -> dict[str, tuple[float, float]]:
    """Bounds (low, high) by parameter; a ValueError for empty ranges."""
    if not bounds:
        raise ValueError(f"A fit needs at least one parameter, such as {list(BOUNDS)}.")
    result = {}
    for name, pair in bounds.items():
        low, high = validate.numbers(pair, f"bounds of {name}", 2)
        if not 0.0 <= low < high:
            raise ValueError(
                f"bounds of {name} must be (low, high) with 0 <= low < high, "
                f"got {validate.shown(pair)}."
            )
        result[name] = (low, high)
    return result
