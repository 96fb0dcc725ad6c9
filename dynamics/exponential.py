"""An exponential step: the modes of the straight arm, frozen, move exactly; the rest is a force.

`aid` holds the modes: see `linear.frozen_modes`.
"""

import numpy as np
from numba.extending import register_jitable


@register_jitable
def propagator(square, damping, h):  # type: ignore[no-untyped-def]
    """y'' + d y' + w^2 y = g over h: what y and y' after h take of y, y' and g.

    As four numbers: y of y, y of y', y' of y', y of g. The others are -w^2 and 1 times the second.
    """
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
def project(w, lanes, n, aid, x, y):  # type: ignore[no-untyped-def]
    """y = L x."""
    for k in range(np.uint64(aid.shape[0])):
        for b in range(lanes):
            w[y + k * lanes + b] = w.dtype.type(0.0)
        for i in range(n // lanes):
            part = w.dtype.type(aid[k, np.uint64(2) + i])
            for b in range(lanes):
                w[y + k * lanes + b] += part * w[x + i * lanes + b]


@register_jitable
def spread(w, lanes, n, aid, y, x):  # type: ignore[no-untyped-def]
    """x += S y."""
    first = np.uint64(2) + n // lanes
    for k in range(np.uint64(aid.shape[0])):
        for i in range(n // lanes):
            part = w.dtype.type(aid[k, first + i])
            for b in range(lanes):
                w[x + i * lanes + b] += part * w[y + k * lanes + b]


@register_jitable
def elastic(w, lanes, aid, y, z):  # type: ignore[no-untyped-def]
    """y becomes w^2 y + d z, the force that the frozen modes take upon themselves."""
    for k in range(np.uint64(aid.shape[0])):
        square, damping = w.dtype.type(aid[k, 0]), w.dtype.type(aid[k, 1])
        for b in range(k * lanes, (k + np.uint64(1)) * lanes):
            w[y + b] = square * w[y + b] + damping * w[z + b]


@register_jitable
def force(w, lanes, n, aid, a, y, g, gy):  # type: ignore[no-untyped-def]
    """The rest g of the accelerations, and L g, from the elastic part at y."""
    for i in range(n):
        w[g + i] = w[a + i]
    spread(w, lanes, n, aid, y, g)
    project(w, lanes, n, aid, a, gy)
    for k in range(np.uint64(aid.shape[0]) * lanes):
        w[gy + k] += w[y + k]


@register_jitable
def flow(w, h, lanes, n, q, v, aid, factors, modal, y1, z1):  # type: ignore[no-untyped-def]
    """Move q and v under a constant rest; new amplitudes and rates of the modes at y1 and z1."""
    y, z, gy, g = modal, modal + n, modal + n + n, modal + n + n + n
    half = w.dtype.type(0.5) * h
    for k in range(np.uint64(aid.shape[0])):
        square = w.dtype.type(aid[k, 0])
        for b in range(k * lanes, (k + np.uint64(1)) * lanes):
            stay, odd = w[factors + b], w[factors + n + b]
            swing, push = w[factors + n + n + b], w[factors + n + n + n + b]
            free = h * (w[z + b] + half * w[gy + b])
            w[y1 + b] = (stay - w.dtype.type(1.0)) * w[y + b] + odd * w[z + b] + push * w[gy + b]
            w[z1 + b] = swing * w[z + b] + odd * (w[gy + b] - square * w[y + b])
            w[y1 + b] -= free
            w[z1 + b] -= w[z + b] + h * w[gy + b]
    for i in range(n):
        w[q + i] += h * (w[v + i] + half * w[g + i])
        w[v + i] += h * w[g + i]
    spread(w, lanes, n, aid, y1, q)
    spread(w, lanes, n, aid, z1, v)
    for k in range(np.uint64(aid.shape[0]) * lanes):
        w[y1 + k] += w[y + k] + h * (w[z + k] + half * w[gy + k])
        w[z1 + k] += w[z + k] + h * w[gy + k]


def start_exponential(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Factors of half and whole steps, and the rest of the present accelerations."""
    modal = s + np.uint64(8) * n
    y, z, gy, g, e = modal, modal + n, modal + n + n, modal + n + n + n, s + np.uint64(12) * n
    for k in range(np.uint64(aid.shape[0])):
        halves = propagator(aid[k, 0], aid[k, 1], 0.5 * h)
        wholes = propagator(aid[k, 0], aid[k, 1], h)
        for b in range(k * lanes, (k + np.uint64(1)) * lanes):
            for j in range(4):
                w[s + np.uint64(j) * n + b] = halves[j]
                w[s + np.uint64(4 + j) * n + b] = wholes[j]
    evaluate(w)
    project(w, lanes, n, aid, q, y)
    project(w, lanes, n, aid, v, z)
    for k in range(np.uint64(aid.shape[0]) * lanes):
        w[e + k] = w[y + k]
    elastic(w, lanes, aid, e, z)
    force(w, lanes, n, aid, a, e, g, gy)


def exponential(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Exponential midpoint rule with the last step's rest to reach the midpoint: order 2.

    One evaluation a step; exact for linear motion about the straight arm under a constant force.
    """
    modal = s + np.uint64(8) * n
    gy, g = modal + n + n, modal + n + n + n
    y1 = s + np.uint64(12) * n
    z1, q0, v0 = y1 + n, y1 + n + n, y1 + n + n + n
    for i in range(n):
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
    flow(w, w.dtype.type(0.5) * h, lanes, n, q, v, aid, s, modal, y1, z1)
    elastic(w, lanes, aid, y1, z1)
    evaluate(w)
    force(w, lanes, n, aid, a, y1, g, gy)
    for i in range(n):
        w[q + i] = w[q0 + i]
        w[v + i] = w[v0 + i]
    flow(w, h, lanes, n, q, v, aid, s + np.uint64(4) * n, modal, y1, z1)
    for k in range(np.uint64(aid.shape[0]) * lanes):
        w[modal + k] = w[y1 + k]
        w[modal + n + k] = w[z1 + k]
