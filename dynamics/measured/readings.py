"""Signals of a log between its samples, smoothed, with their rates.

Times, signals, delays and time constants may be complex: imaginary parts are a direction, and those
of the results the derivatives along it.
"""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dynamics.types import AnyArray, Array

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

    def at(self, times: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Values and rates (..., c) at times (..., c) [s]; those of the ends beyond them."""
        values, rates = np.empty_like(times), np.empty_like(times)
        for k, curve in enumerate(self._curves):
            time = times[..., k]
            t = np.clip(time.real, curve.x[0], curve.x[-1])
            along = np.where(t == time.real, time - time.real, 0.0)
            values[..., k] = curve(t) + along * curve(t, 1)
            rates[..., k] = curve(t, 1) + along * curve(t, 2)
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


def delayed(time: Array, after: AnyArray, before: AnyArray, delay: AnyArray) -> AnyArray:
    """Signals (N, P, c) of P motions as late as delays (P, c) [s] say, by cubic polynomials.

    Parameters
    ----------
    time : (N,) [s]
    after, before : (2, N, P, c) signals and their rates at the start and at the end of the steps
        that begin and end with a sample; they differ where a motion starts again.
    """
    result = np.empty(before.shape[1:], np.result_type(before, delay))
    motions = np.arange(delay.shape[0])
    for c in range(delay.shape[1]):
        at = time[:, None] - delay[:, c]
        j = np.clip(np.searchsorted(time, at.real) - 1, 0, len(time) - 2)
        h = time[j + 1] - time[j]
        s = np.where(at.real < time[0], 0.0, (at - time[j]) / h)
        (y0, v0), (y1, v1) = after[:, j, motions, c], before[:, j + 1, motions, c]
        bend = s * (1.0 - s) * (h * (v0 * (1.0 - s) - v1 * s) + (y1 - y0) * (2.0 * s - 1.0))
        result[..., c] = y0 + s * (y1 - y0) + bend
    return result


def low_passed(
    time: Array, after: AnyArray, before: AnyArray, lag: AnyArray
) -> tuple[AnyArray, AnyArray]:
    """Signals and rates behind a low pass of first order, as `delayed` takes them.

    Cubics between samples are followed exactly. At the start the filter is in the state after a
    steady motion.

    Parameters
    ----------
    lag : (P, c) [s] time constants; 0 passes everything.
    """
    h = np.diff(time)[:, None, None]
    ends = _forced(h, after[:, :-1], before[:, 1:], lag)
    some = np.maximum(lag.real, TINY) + (lag - lag.real)
    kept = np.exp(-h / some)
    jumps = np.where(lag.real > TINY, (after[0] - before[0]) / some, after[1] - before[1])
    rates = [before[1, 0]]
    for begin, end, share, jump in zip(*ends, kept, jumps, strict=False):
        rates.append(end + share * (rates[-1] + jump - begin))
    values = before[0] - lag * np.array(rates)
    return np.stack([values, rates + jumps]), np.stack([values, rates])


def _forced(h: Array, begin: AnyArray, end: AnyArray, lag: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Rates behind a cubic without transients, at the ends of its steps.

    They are x' - T x'' + T^2 x''' of the cubic x.
    """
    (y0, v0), (y1, v1) = begin, end
    rise = 6.0 * (y1 - y0) / h
    third = (6.0 * (v0 + v1) - 2.0 * rise) / h**2
    second = ((rise - 4.0 * v0 - 2.0 * v1) / h, (4.0 * v1 + 2.0 * v0 - rise) / h)
    first, last = (v - lag * (bend - lag * third) for v, bend in zip((v0, v1), second, strict=True))
    return first, last
