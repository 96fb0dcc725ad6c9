"""An exponential step: the modes of the straight arm, frozen, move exactly; the rest is a force.

A step keeps the arm's amplitudes y = L q, their rates z = L v and the rest g of their
accelerations, y'' + d y' + w^2 y = g, and leaves them only to evaluate.
"""

from typing import Any, NamedTuple

import numpy as np


class FrozenModes(NamedTuple):
    """Modes of the straight arm with free joints, those that move as rigid bodies among them."""

    squares: Any  # (n,) [1/s^2] squared frequencies; zero of rigid motions
    decays: Any  # (n,) [1/s] damping; zero of rigid motions
    L: Any = None  # (n, n) amplitudes y = L q
    S: Any = None  # (n, n) coordinates q = S y


def propagator(square, damping, h):  # type: ignore[no-untyped-def]
    """y'' + d y' + w^2 y = g over h: what y and y' after h take of y, y' and g.

    As four numbers: y of y, y of y', y' of y', y of g. The others are -w^2 and 1 times the second.
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
    """Factors of half and whole steps; compiled as it stands."""
    for k in range(np.uint64(aid.squares.size)):
        halves = propagator(aid.squares[k], aid.decays[k], 0.5 * h)
        wholes = propagator(aid.squares[k], aid.decays[k], h)
        for b in range(k * at.lanes, (k + np.uint64(1)) * at.lanes):
            for j in range(4):
                w[at.s + np.uint64(j) * at.n + b] = halves[j]
                w[at.s + np.uint64(4 + j) * at.n + b] = wholes[j]


def _product(matrix: Any, x: list[Any]) -> list[Any]:
    return [sum(float(part) * value for part, value in zip(row, x, strict=True)) for row in matrix]


def _values(w: Any, first: int, n: int) -> list[Any]:
    return [w[first + i] for i in range(n)]


def _place(w: Any, first: int, values: list[Any]) -> None:
    for i, value in enumerate(values):
        w[first + i] = value


def _flow(w: Any, n: int, factors: int, modal: int, aid: Any) -> tuple[list[Any], list[Any]]:
    """Amplitudes and rates of the modes after a step under a constant rest."""
    amplitudes, rates = [], []
    for k in range(n):
        y, z, g = (w[modal + j * n + k] for j in range(3))
        stay, odd, swing, push = (w[factors + j * n + k] for j in range(4))
        amplitudes.append(stay * y + odd * z + push * g)
        rates.append(swing * z + odd * (g - float(aid.squares[k]) * y))
    return amplitudes, rates


def _elastic(aid: Any, y: list[Any], z: list[Any]) -> list[Any]:
    """w^2 y + d z, the force that the modes take upon themselves."""
    numbers = zip(aid.squares.tolist(), aid.decays.tolist(), y, z, strict=True)
    return [square * x + decay * rate for square, decay, x, rate in numbers]


def _add_forces(w: Any, at: Any, rest: int, aid: Any) -> None:
    """Turn the elastic part of the rest into the whole of it."""
    for k, force in enumerate(_product(aid.L, _values(w, at.a, at.n))):
        w[rest + k] += force


def start_exponential(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Amplitudes of the modes, their rates, and the rest of the present accelerations."""
    modal = at.s + 8 * at.n
    evaluate(w)
    y, z = (_product(aid.L, _values(w, first, at.n)) for first in (at.q, at.v))
    _place(w, modal, [*y, *z, *_elastic(aid, y, z)])
    _add_forces(w, at, modal + 2 * at.n, aid)


def exponential(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Exponential midpoint rule with the last step's rest to reach the midpoint: order 2.

    One evaluation a step; exact for linear motion about the straight arm under a constant force.
    """
    n = at.n
    modal = at.s + 8 * n
    y, z = _flow(w, n, at.s, modal, aid)
    _place(w, at.q, _product(aid.S, y))
    _place(w, at.v, _product(aid.S, z))
    _place(w, modal + 2 * n, _elastic(aid, y, z))
    evaluate(w)
    _add_forces(w, at, modal + 2 * n, aid)
    y, z = _flow(w, n, at.s + 4 * n, modal, aid)
    _place(w, at.q, _product(aid.S, y))
    _place(w, at.v, _product(aid.S, z))
    _place(w, modal, [*y, *z])
