"""Exponential step: the modes of the straight arm are integrated exactly, the rest as a force.

The step works on modal amplitudes y = L q and rates z = L v with y'' + d y' + w^2 y = g, where the
remainder g is L a + w^2 y + d z. It returns to q and v only to evaluate the accelerations a.
"""

from typing import Any, NamedTuple

import numpy as np


class FrozenModes(NamedTuple):
    """Modes of the straight arm with free joints, including its rigid motions."""

    squares: Any  # (n,) [1/s^2] squared frequencies; zero for rigid motions
    decays: Any  # (n,) [1/s] damping; zero for rigid motions
    L: Any = None  # (n, n) amplitudes y = L q
    S: Any = None  # (n, n) coordinates q = S y


def propagator(square, damping, h):  # type: ignore[no-untyped-def]
    """Four factors that solve y'' + d y' + w^2 y = g exactly over h under a constant g.

    Factors of y in y(h), of y' in y(h), of y' in y'(h) and of g in y(h). Those of y and g in y'(h)
    are -w^2 and 1 times the second.
    """
    if square == 0.0:
        return 1.0, h, 1.0, 0.5 * h * h
    decay = 0.5 * damping
    rest = square - decay * decay
    if rest > 0.0:
        rate = np.sqrt(rest)
        shrink = np.exp(-decay * h)
        even, odd = shrink * np.cos(rate * h), shrink * np.sin(rate * h) / rate
    else:
        rate = np.sqrt(1e-12 * square - rest)
        slow, fast = np.exp((rate - decay) * h), np.exp(-(rate + decay) * h)
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / rate
    stay = even + decay * odd
    return stay, odd, even - decay * odd, (1.0 - stay) / square


def prepare_exponential(w, h, at, aid):  # type: ignore[no-untyped-def]
    """Store the propagator's factors of half and whole steps; compiled by numba, not recorded."""
    for k in range(np.uint64(aid.squares.size)):
        halves = propagator(aid.squares[k], aid.decays[k], 0.5 * h)
        wholes = propagator(aid.squares[k], aid.decays[k], h)
        for b in range(k * at.lanes, (k + np.uint64(1)) * at.lanes):
            for j in range(4):
                w[at.s + np.uint64(j) * at.n + b] = halves[j]
                w[at.s + np.uint64(4 + j) * at.n + b] = wholes[j]


def _product(matrix: Any, x: list[Any]) -> list[Any]:
    return [sum(float(part) * value for part, value in zip(row, x, strict=True)) for row in matrix]


def _load(w: Any, first: int, n: int) -> list[Any]:
    return [w[first + i] for i in range(n)]


def _store(w: Any, first: int, values: list[Any]) -> None:
    for i, value in enumerate(values):
        w[first + i] = value


def _advanced(w: Any, n: int, factors: int, modal: int, aid: Any) -> tuple[list[Any], list[Any]]:
    """Amplitudes and rates of the modes after the factors' step under a constant g."""
    amplitudes, rates = [], []
    for k in range(n):
        y, z, g = (w[modal + j * n + k] for j in range(3))
        stay, odd, swing, push = (w[factors + j * n + k] for j in range(4))
        amplitudes.append(stay * y + odd * z + push * g)
        rates.append(swing * z + odd * (g - float(aid.squares[k]) * y))
    return amplitudes, rates


def _linear_forces(aid: Any, y: list[Any], z: list[Any]) -> list[Any]:
    """w^2 y + d z, the linear forces that the propagator integrates."""
    numbers = zip(aid.squares.tolist(), aid.decays.tolist(), y, z, strict=True)
    return [square * x + decay * rate for square, decay, x, rate in numbers]


def _add_accelerations(w: Any, at: Any, g: int, aid: Any) -> None:
    """Add L a to the linear forces at slot `g`, which completes the remainder."""
    for k, value in enumerate(_product(aid.L, _load(w, at.a, at.n))):
        w[g + k] += value


def start_exponential(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Store modal amplitudes, rates and the remainder g of the present accelerations."""
    modal = at.s + 8 * at.n
    evaluate(w)
    y, z = (_product(aid.L, _load(w, first, at.n)) for first in (at.q, at.v))
    _store(w, modal, [*y, *z, *_linear_forces(aid, y, z)])
    _add_accelerations(w, at, modal + 2 * at.n, aid)


def exponential(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Exponential midpoint rule that reaches the midpoint with the last step's g: order 2.

    One evaluation per step. Exact for linear motion about the straight arm under a constant force.
    """
    n = at.n
    modal = at.s + 8 * n
    y, z = _advanced(w, n, at.s, modal, aid)
    _store(w, at.q, _product(aid.S, y))
    _store(w, at.v, _product(aid.S, z))
    _store(w, modal + 2 * n, _linear_forces(aid, y, z))
    evaluate(w)
    _add_accelerations(w, at, modal + 2 * n, aid)
    y, z = _advanced(w, n, at.s + 4 * n, modal, aid)
    _store(w, at.q, _product(aid.S, y))
    _store(w, at.v, _product(aid.S, z))
    _store(w, modal, [*y, *z])
