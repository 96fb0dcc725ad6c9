"""Weighted least squares between measured signals and those of an arm: search, then solution.

Constant offsets of the signals, and in the search the start too, are eliminated as linear unknowns.
Solutions use exact derivatives of the motion. The search takes differences by the start, which cost
less and need not be exact.
A long log has many valleys, each a cycle of the oscillation wide. The search follows the lowest
from the log's first samples to all of them, twice as many at a time. A motion that starts again and
again has few, and the search tries few points.
"""

from itertools import product

import numpy as np
from scipy.optimize import least_squares
from scipy.stats.qmc import LatinHypercube

from dynamics.measured.motion import LoggedMotion
from dynamics.measured.unknowns import Bounds
from dynamics.types import Array

STARTS = 600  # points of the search, on a grid over the bounds
FEW = 40  # points of the search where the motion starts again and again
MOST_ON_GRID = 5  # parameters; more are searched at random
SEED = 0  # of the random points
MOST_MOTIONS = 2000  # of the search
DIFFERENCE = 1e-5  # [of an unknown's size] width of the differences by the start in the search
SOME, MOST = 0.1, 0.5  # [of the squared signals] in the part that chooses steps, tries the grid
FEWEST = 4  # values of the signals per unknown in the first part of a log
MOST_STEPS = 60  # of a solution
ROUGH = 1e-4  # tolerance of the solutions on parts of a log


def search(motion: LoggedMotion, bounds: Bounds) -> Array:
    """(k,) values near the best ones within the bounds."""
    table = motion.unknowns
    weights = 1.0 / motion.deviation
    parts = _parts(motion)
    some, most = (_with_share(motion, parts, share) for share in (SOME, MOST))
    corners = _points(motion, _corners(bounds))
    while not np.isfinite(starts := _projected(motion, corners, weights, [some])[1][0]).all():
        motion.halve_steps()
    motion.refine(starts, some)
    fewer = min(STARTS, MOST_MOTIONS // (1 + int(np.sum(~table.asked))))
    grid = _points(motion, _grid(bounds, FEW if motion.restarts else fewer))
    first = [part for part in parts if part <= most]
    costs, found = _projected(motion, np.vstack([table.nominal, grid]), weights, first)
    inside = ((found >= table.low) & (found <= table.high)).all(axis=2)
    costs = np.where(inside & np.isfinite(costs), costs, np.inf)
    best = found[0, np.argmin(costs[0])]
    for k, part in enumerate(parts):
        if k < len(first) and not _cost(motion, best, weights, part) < costs[k].min():
            best = found[k, np.argmin(costs[k])]
        if motion.restarts:
            motion.substeps = 2  # corners of the bounds need finer steps than the rig
        motion.refine(best[None], part)
        if part < parts[-1]:
            best = solve(motion, best, weights, part)[0]
    return best


def solve(
    motion: LoggedMotion, values: Array, weights: Array, samples: int | None = None
) -> tuple[Array, Array, Array]:
    """Best values (k,) near given ones, their residual (N, c) and its weighted Jacobian (N c, k).

    `samples` limits the log to its first ones, and the accuracy to a rough one.
    """
    table = motion.unknowns
    known = table.precision(weights)
    measured, present = motion.measured[:samples], motion.present[:samples]

    def residual(x: Array) -> Array:
        return _without_offset(motion.signals(x[None], samples)[0] - measured, present)

    def jacobian(x: Array) -> Array:
        slopes = _without_offset(motion.slopes(x, samples), present) * weights
        return slopes.reshape(x.size, -1).T

    exact = samples is None
    found = least_squares(
        lambda x: np.append(residual(x) * weights, known * (x - table.nominal)),
        np.clip(values, table.low, table.high),
        lambda x: np.vstack([jacobian(x), np.diag(known)]),
        bounds=(table.low, table.high), x_scale=table.size,
        xtol=1e-10 if exact else ROUGH, ftol=1e-12 if exact else ROUGH, max_nfev=MOST_STEPS,
    )  # fmt: skip
    return found.x, residual(found.x), jacobian(found.x)


def _parts(motion: LoggedMotion) -> list[int]:
    """Numbers of first samples of the log, the last that of all, each half of the next."""
    count, signals = motion.measured.shape
    result = [count]
    while not motion.restarts and result[0] // 2 * signals >= FEWEST * motion.unknowns.size.size:
        result.insert(0, result[0] // 2)
    return result


def _with_share(motion: LoggedMotion, parts: list[int], share: float) -> int:
    """The first part of the log that holds a share of the squared signals."""
    moved = _without_offset(motion.measured, motion.present) / motion.deviation
    size = np.cumsum(np.sum(moved**2, axis=1))
    return next(part for part in parts if size[part - 1] >= share * size[-1])


def _points(motion: LoggedMotion, parameters: Array) -> Array:
    """(P, k) values with parameters (P, p) and a nominal start."""
    values = np.tile(motion.unknowns.nominal, (len(parameters), 1))
    values[:, motion.unknowns.asked] = parameters
    return values


def _grid(bounds: Bounds, most: int) -> Array:
    """(P, p) points over the bounds, about `most`, at equal ratios where no bound is zero."""
    if len(bounds) > MOST_ON_GRID:
        points = LatinHypercube(len(bounds), rng=np.random.default_rng(SEED)).random(most)
        pairs = zip(bounds.values(), points.T, strict=True)
        return np.stack([_between(*pair, share) for pair, share in pairs], axis=1)
    count = max(2, round(most ** (1.0 / len(bounds))))
    axes = (_between(*pair, np.linspace(0.0, 1.0, count)) for pair in bounds.values())
    return np.array(list(product(*axes)))


def _between(low: float, high: float, share: Array) -> Array:
    """Points between bounds, at ratios where none is zero."""
    ends = np.array([1.0 - share, share])
    result: Array = np.exp(np.log([low, high]) @ ends) if low else high * share
    return result


def _corners(bounds: Bounds) -> Array:
    """(P, p) combinations of low and high; of many parameters, all low and each of them high."""
    pairs = np.array(list(bounds.values()))
    if len(bounds) > MOST_ON_GRID:
        return np.vstack([pairs.T, pairs[:, 0] + np.diag(pairs[:, 1] - pairs[:, 0])])
    return np.array(list(product(*pairs.tolist())))


def _projected(
    motion: LoggedMotion, values: Array, weights: Array, parts: list[int]
) -> tuple[Array, Array]:
    """Least costs (parts, P) of values (P, k) by the start alone, and values with that start."""
    table = motion.unknowns
    start = np.flatnonzero(~table.asked)
    known = table.precision(weights)[start]
    steps = DIFFERENCE * table.size[start]
    moved = np.zeros((1 + start.size, len(table.nominal)))
    moved[1 + np.arange(start.size), start] = steps
    costs = np.empty((len(parts), len(values)))
    found = np.tile(values, (len(parts), 1, 1))
    size = max(1, motion.together(parts[-1]) // len(moved))
    for k in range(0, len(values), size):
        group = slice(k, k + size)
        points = (values[group, None] + moved).reshape(-1, values.shape[1])
        signals = motion.signals(points, parts[-1])
        signals = signals.reshape(-1, len(moved), *signals.shape[1:])
        base, slopes = signals[:, 0], (signals[:, 1:] - signals[:, :1]) / steps[:, None, None]
        for j, part in enumerate(parts):
            present = motion.present[:part]
            r = _without_offset(base[:, :part] - motion.measured[:part], present) * weights
            S = _without_offset(slopes[:, :, :part], present) * weights
            r, S = r.reshape(len(r), -1, 1), S.reshape(*S.shape[:2], r[0].size)
            gradient = S @ r
            change = -np.linalg.solve(S @ S.swapaxes(1, 2) + np.diag(known**2), gradient)
            costs[j, group] = np.sum(r**2, axis=(1, 2)) + np.sum(gradient * change, axis=(1, 2))
            found[j, group][:, start] += change[..., 0]
    return costs, found


def _cost(motion: LoggedMotion, values: Array, weights: Array, samples: int) -> float:
    signals = motion.signals(values[None], samples)[0]
    misfit = _without_offset(signals - motion.measured[:samples], motion.present[:samples])
    prior = motion.unknowns.precision(weights) * (values - motion.unknowns.nominal)
    return float(np.sum((misfit * weights) ** 2) + np.sum(prior**2))


def _without_offset(difference: Array, present: Array) -> Array:
    """Signals (..., N, c) less their means over the samples present, and zero at the others."""
    count = np.maximum(present.sum(axis=0), 1)
    mean = np.where(present, difference, 0.0).sum(axis=-2, keepdims=True) / count
    result: Array = np.where(present, difference - mean, 0.0)
    return result
