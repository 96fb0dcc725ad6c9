"""Signals of a log between its samples, smoothed, with their rates."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dynamics.types import Array

ORDER = 3  # of the polynomials
FEWEST = 5  # readings in a window
TINY = 1e-12  # [s] time constant that counts as none


class Readings:
    """Local polynomials of every signal, joined to a curve with continuous rates.

    Parameters
    ----------
    time : (N,) [s]
    measured : (N, c) signals, NaN where there is no reading.
    span : [s] width of a polynomial's window.
    """

    def __init__(self, time: Array, measured: Array, span: float) -> None:
        self._curves = [_smoothed(time, column, span) for column in measured.T]

    def at(self, times: Array) -> tuple[Array, Array]:
        """Values and rates (..., c) at times (..., c) [s]; those of the ends beyond them."""
        values, rates = np.empty(times.shape), np.empty(times.shape)
        for k, curve in enumerate(self._curves):
            t = np.clip(times[..., k], curve.x[0], curve.x[-1])
            values[..., k], rates[..., k] = curve(t), curve(t, 1)
        return values, rates


def _smoothed(time: Array, column: Array, span: float) -> CubicHermiteSpline:
    there = np.isfinite(column)
    t, y = time[there], column[there]
    window = min(max(FEWEST, round(span / float(np.median(np.diff(t))))), t.size)
    first = np.clip(np.arange(t.size) - window // 2, 0, t.size - window)
    near = first[:, None] + np.arange(window)
    x = t[near] - t[:, None]
    size = np.abs(x).max(axis=1)
    V = (x / size[:, None])[..., None] ** np.arange(ORDER + 1)
    fitted = np.linalg.solve(V.swapaxes(1, 2) @ V, V.swapaxes(1, 2) @ y[near][..., None])[..., 0]
    return CubicHermiteSpline(t, fitted[:, 0], fitted[:, 1] / size)


def delayed(time: Array, after: Array, before: Array, delay: Array) -> Array:
    """Signals (N, P, c) of P motions as late as delays (P, c) [s] say, by cubic polynomials.

    Parameters
    ----------
    time : (N,) [s]
    after, before : (2, N, P, c) signals and their rates at the start and at the end of the steps
        that begin and end with a sample; they differ where a motion starts again.
    """
    result = np.empty(before.shape[1:])
    motions = np.arange(delay.shape[0])
    for c in range(delay.shape[1]):
        at = time[:, None] - delay[:, c]
        j = np.clip(np.searchsorted(time, at) - 1, 0, len(time) - 2)
        h = time[j + 1] - time[j]
        s = np.clip((at - time[j]) / h, 0.0, 1.0)
        (y0, v0), (y1, v1) = after[:, j, motions, c], before[:, j + 1, motions, c]
        bend = s * (1.0 - s) * (h * (v0 * (1.0 - s) - v1 * s) + (y1 - y0) * (2.0 * s - 1.0))
        result[..., c] = y0 + s * (y1 - y0) + bend
    return result


def low_passed(time: Array, after: Array, before: Array, lag: Array) -> tuple[Array, Array]:
    """Signals and rates behind a low pass of first order, as `delayed` takes them.

    Cubics between samples are followed exactly. At the start the filter is in the state after a
    steady motion.

    Parameters
    ----------
    lag : (P, c) [s] time constants; 0 passes everything.
    """
    h = np.diff(time)[:, None, None]
    ends = _forced(h, after[:, :-1], before[:, 1:], lag)
    kept = np.exp(-h / np.maximum(lag, TINY))
    y = [after[0, 0] - lag * after[1, 0]]
    for (begin, end), share in zip(zip(*ends, strict=True), kept, strict=True):
        y.append(end + share * (y[-1] - begin))
    values = np.array(y)

    def with_rates(x: Array) -> Array:
        rates = np.where(lag > TINY, (x[0] - values) / np.maximum(lag, TINY), x[1])
        return np.stack([values, rates])

    return with_rates(after), with_rates(before)


def _forced(h: Array, begin: Array, end: Array, lag: Array) -> tuple[Array, Array]:
    """Response without transients to the cubic of a step, x - T x' + T^2 x'' - ..., at its ends."""
    (y0, v0), (y1, v1) = begin, end
    rise = 6.0 * (y1 - y0) / h
    third = (6.0 * (v0 + v1) - 2.0 * rise) / h**2
    second = ((rise - 4.0 * v0 - 2.0 * v1) / h, (4.0 * v1 + 2.0 * v0 - rise) / h)
    first, last = (
        x - lag * (v - lag * (bend - lag * third))
        for (x, v), bend in zip((begin, end), second, strict=True)
    )
    return first, last
