"""Compiled steps of all filters: by readings, and ahead by torques.

One file, because compiled code is kept for the text of the file that it comes from.
"""

from typing import Any

import numpy as np

from dynamics.runtime.jit import compiled, outermost


@outermost
def take(
    group: Any, steps: Any, delays: Any, readings: Any, changed: Any, moving: bool,
    A: Any, B: Any, C: Any, D: Any, seen: Any, gain: Any, precision: Any, bulk: Any,
    torque: Any, place: Any, state: Any, surprise: Any,
) -> None:  # fmt: skip
    """Update the filters of the environments of one bank that new readings reach."""
    P, _, S = B.shape
    y, n = seen.shape
    moved, innovation = np.empty(S), np.empty(y)
    for i in group:
        for h in range(P * len(delays)):
            p, delay = h // len(delays), delays[h % len(delays)]
            late, ago = steps[i] - delay, torque.shape[1] - 1 - delay
            if late <= 0 and steps[i] > 0:
                if changed[i]:
                    surprise[i, h] = np.inf
                continue
            if surprise[i, h] == np.inf:
                continue
            x = state[i, h]
            _copy(readings[i], innovation)
            if steps[i] == 0:
                _copy(x, moved)
            else:
                _move(A[p], B[p], x, torque[i, ago, p], moved)
                for b in range(D.shape[1]):
                    for a in range(y):
                        innovation[a] -= D[p, b, a] * torque[i, ago, p, b]
            for b in range(S):
                for a in range(y):
                    innovation[a] -= C[p, b, a] * moved[b]
            if moving:
                for a in range(y):
                    for b in range(n):
                        innovation[a] -= seen[a, b] * place[i, ago + 1, p, b]
            k = min(max(late, 0), len(bulk) - 1)
            surprise[i, h] += _surprise_of(innovation, precision[k, p], bulk[k, p])
            _copy(moved, x)
            for b in range(y):
                for a in range(S):
                    x[a] += gain[k, p, b, a] * innovation[b]


@outermost
def predict(
    group: Any, steps: Any, delays: Any, A: Any, B: Any, torque: Any, state: Any, surprise: Any,
    order: Any, caution: float, best: Any, now: Any,
) -> None:  # fmt: skip
    """The plants that are assumed, and their states with the torques since the readings.

    They are the first of `order` whose surprise exceeds the least by no more than `caution`.
    """
    moved = np.empty(A.shape[1])
    for i in group:
        most = surprise[i].min() + caution
        for h in order:  # which ends at the plant
            if surprise[i, h] <= most:
                break
        p, delay = h // len(delays), delays[h % len(delays)]
        best[i] = p
        _copy(state[i, h], moved)
        _copy(moved, now[i])
        for age in range(min(delay, steps[i]), 0, -1):
            _move(A[p], B[p], now[i], torque[i, torque.shape[1] - age, p], moved)
            _copy(moved, now[i])


@outermost
def correct(
    group: Any, steps: Any, delays: Any, readings: Any, alive: Any, origin: Any, shapes: Any,
    seen: Any, gain: Any, precision: Any, bulk: Any, state: Any, surprise: Any,
) -> None:  # fmt: skip
    """Correct the predicted states of the environments of one bank by their readings."""
    y, n = seen.shape
    _, r, _ = shapes.shape
    biases, innovation = gain.shape[3] - 2 * r, np.empty(y)
    for i in group:
        for h in range(alive.shape[1]):
            if not alive[i, h]:
                continue
            p, late, x = h // len(delays), steps[i] - delays[h % len(delays)], state[i, h]
            _copy(readings[i], innovation)
            for a in range(y):
                for j in range(n):
                    innovation[a] -= seen[a, j] * (x[j] - origin[i, j])
            for b in range(biases):
                innovation[y - biases + b] -= x[2 * n + b]
            k = min(max(late, 0), len(bulk) - 1)
            surprise[i, h] += _surprise_of(innovation, precision[k, p], bulk[k, p])
            for a in range(gain.shape[3]):
                change = 0.0
                for b in range(y):
                    change += gain[k, p, b, a] * innovation[b]
                if a >= 2 * r:
                    x[2 * n + a - 2 * r] += change
                else:
                    part = n * (a // r)
                    for j in range(n):
                        x[part + j] += shapes[p, a % r, j] * change


@compiled
def _copy(source: Any, target: Any) -> None:
    """Copy the entries that both have."""
    for a in range(min(len(source), len(target))):
        target[a] = source[a]


@compiled
def _move(A: Any, B: Any, x: Any, torque: Any, moved: Any) -> None:
    """Write the state after a control step; matrices are transposed."""
    for a in range(len(moved)):
        moved[a] = 0.0
    for b in range(len(moved)):
        for a in range(len(moved)):
            moved[a] += A[b, a] * x[b]
    for b in range(len(torque)):
        for a in range(len(moved)):
            moved[a] += B[b, a] * torque[b]


@compiled
def _surprise_of(innovation: Any, precision: Any, bulk: float) -> float:
    """Minus twice the logarithm of a reading's probability; `bulk` is that of the likeliest."""
    total = bulk
    for a in range(len(innovation)):
        for b in range(len(innovation)):
            total += innovation[a] * precision[a, b] * innovation[b]
    return total
