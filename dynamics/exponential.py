"""An exponential step: the modes of the straight arm, frozen, move exactly; the rest is a force.

`aid` holds the modes, those that move as rigid bodies among them: see `linear.frozen_modes`. A
step keeps the arm's amplitudes y = L q, their rates z = L v and the rest g of their accelerations,
y'' + d y' + w^2 y = g, and leaves them only to evaluate.
"""

from typing import Any

import numpy as np
from numba.extending import register_jitable


@register_jitable
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


@register_jitable
def prepare_exponential(w, h, lanes, n, s, aid):  # type: ignore[no-untyped-def]
    """Factors of half and whole steps."""
    for k in range(np.uint64(aid.shape[0])):
        halves = propagator(aid[k, 0], aid[k, 1], 0.5 * h)
        wholes = propagator(aid[k, 0], aid[k, 1], h)
        for b in range(k * lanes, (k + np.uint64(1)) * lanes):
            for j in range(4):
                w[s + np.uint64(j) * n + b] = halves[j]
                w[s + np.uint64(4 + j) * n + b] = wholes[j]


def _product(matrix: Any, x: list[Any]) -> list[Any]:
    return [sum(float(part) * value for part, value in zip(row, x, strict=True)) for row in matrix]


def _flow(w: Any, n: int, factors: int, modal: int, aid: Any) -> tuple[list[Any], list[Any]]:
    """Amplitudes and rates of the modes after a step under a constant rest."""
    amplitudes, rates = [], []
    for k in range(n):
        y, z, g = (w[modal + j * n + k] for j in range(3))
        stay, odd, swing, push = (w[factors + j * n + k] for j in range(4))
        amplitudes.append(stay * y + odd * z + push * g)
        rates.append(swing * z + odd * (g - float(aid[k, 0]) * y))
    return amplitudes, rates


def _elastic(aid: Any, y: list[Any], z: list[Any]) -> list[Any]:
    """w^2 y + d z, the force that the modes take upon themselves."""
    numbers = zip(aid[:, :2].tolist(), y, z, strict=True)
    return [square * x + decay * rate for (square, decay), x, rate in numbers]


def _place(w: Any, first: int, values: list[Any]) -> None:
    for i, value in enumerate(values):
        w[first + i] = value


def _add_forces(w: Any, n: int, a: int, rest: int, aid: Any) -> None:
    """Turn the elastic part of the rest into the whole of it."""
    forces = _product(aid[:, 2 : 2 + n], [w[a + i] for i in range(n)])
    for k, force in enumerate(forces):
        w[rest + k] += force


def start_exponential(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Amplitudes of the modes, their rates, and the rest of the present accelerations."""
    modal, L = s + 8 * n, aid[:, 2 : 2 + n]
    evaluate(w)
    y, z = (_product(L, [w[x + i] for i in range(n)]) for x in (q, v))
    _place(w, modal, [*y, *z, *_elastic(aid, y, z)])
    _add_forces(w, n, a, modal + 2 * n, aid)


def exponential(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Exponential midpoint rule with the last step's rest to reach the midpoint: order 2.

    One evaluation a step; exact for linear motion about the straight arm under a constant force.
    """
    modal, S = s + 8 * n, aid[:, 2 + n :].T
    y, z = _flow(w, n, s, modal, aid)
    _place(w, q, _product(S, y))
    _place(w, v, _product(S, z))
    _place(w, modal + 2 * n, _elastic(aid, y, z))
    evaluate(w)
    _add_forces(w, n, a, modal + 2 * n, aid)
    y, z = _flow(w, n, s + 4 * n, modal, aid)
    _place(w, q, _product(S, y))
    _place(w, v, _product(S, z))
    _place(w, modal, [*y, *z])
