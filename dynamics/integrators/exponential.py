"""Exponential steps: the modes of the straight arm are integrated exactly, the rest as a force.

A step works on modal amplitudes y = L q and rates z = L v with y'' + d y' + w^2 y = g, where the
remainder is g = L a + w^2 y + d z. It evaluates g at Gauss nodes, one after the other: the state at
a node follows from the polynomial through the nodes before it, the end of the step from all. A step
of m nodes takes m evaluations, and its remainder is as accurate as Gauss quadrature of m points.

At the start of a call, under a new torque, the remainder is that of the frozen modes, S' B tau; at
the next step of the call it is where the polynomial before ends. For linear motion about the
straight arm under a constant torque every step is exact.
"""

from typing import Any, NamedTuple

import numpy as np

POINTS, WEIGHTS = np.polynomial.legendre.leggauss(16)  # of integrals over an impulse response
PANELS = 8  # of each integral: exact to round-off for phases of up to 50 rad per step


class FrozenModes(NamedTuple):
    """Modes of the straight arm with free joints, including its rigid motions."""

    squares: Any  # (n,) [1/s^2] squared frequencies; zero for rigid motions
    decays: Any  # (n,) [1/s] damping; zero for rigid motions
    L: Any = None  # (n, n) amplitudes y = L q
    S: Any = None  # (n, n) coordinates q = S y
    drive: Any = None  # (n, n_torque) S' B: remainder per torque


def response(square, damping, t):  # type: ignore[no-untyped-def]
    """Factors of y in y(t), of y' in y(t), of y' in y'(t), of y'' + d y' + w^2 y = 0.

    The second is the response to a unit impulse, the third its derivative. That of y in y'(t) is
    -w^2 times the second.
    """
    if square == 0.0:
        return 1.0, t, 1.0
    decay = 0.5 * damping
    rest = square - decay * decay
    if rest > 0.0:
        rate = np.sqrt(rest)
        shrink = np.exp(-decay * t)
        even, odd = shrink * np.cos(rate * t), shrink * np.sin(rate * t) / rate
    else:
        rate = np.sqrt(1e-12 * square - rest)
        slow, fast = np.exp((rate - decay) * t), np.exp(-(rate + decay) * t)
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / rate
    return even + decay * odd, odd, even - decay * odd


def basis(nodes, count, j, x):  # type: ignore[no-untyped-def]
    """Value at x of the polynomial that is one at node j of the first `count`, zero at others."""
    value = 1.0
    for k in range(count):
        if k != j:
            value *= (x - nodes[k]) / (nodes[j] - nodes[k])
    return value


def pushes(square, damping, h, end, nodes, count, j):  # type: ignore[no-untyped-def]
    """Factors of g at node j in y and y' at the time `end` h, by the first `count` nodes."""
    width = end / PANELS
    by_y, by_z = 0.0, 0.0
    for panel in range(PANELS):
        for k in range(POINTS.size):
            x = width * (panel + 0.5 + 0.5 * POINTS[k])
            _, odd, swing = response(square, damping, (end - x) * h)
            weight = 0.5 * width * h * WEIGHTS[k] * basis(nodes, count, j, x)
            by_y += weight * odd
            by_z += weight * swing
    return by_y, by_z


def prepare_nodes(w, h, at, aid, nodes):  # type: ignore[no-untyped-def]
    """Store the factors of each node's state and of the end, as `Factors` orders them."""
    m = nodes.size
    for k in range(np.uint64(aid.squares.size)):
        square, damping = aid.squares[k], aid.decays[k]
        row = 0
        for stage in range(m + 1):
            end = 1.0 if stage == m else nodes[stage]
            first = response(square, damping, end * h)
            for j in range(3 + 2 * max(stage, 1)):
                if j < 3:
                    value = first[j]
                elif stage == 0:  # a constant remainder
                    both = pushes(square, damping, h, end, nodes, 1, 0)
                    value = both[j - 3]
                else:
                    both = pushes(square, damping, h, end, nodes, stage, (j - 3) // 2)
                    value = both[(j - 3) % 2]
                for b in range(k * at.lanes, (k + np.uint64(1)) * at.lanes):
                    w[at.s + np.uint64(row) * at.n + b] = value
                row += 1


class GaussStep:
    """An exponential step with a number of Gauss nodes: its functions for `table.INTEGRATORS`."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.nodes = 0.5 + 0.5 * np.polynomial.legendre.leggauss(count)[0]
        self.factors = sum(3 + 2 * max(stage, 1) for stage in range(count + 1))
        self.scratch = self.factors + count + 3  # n values each: y, z, g at the start, g at nodes

    def start(self, w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
        """Store modal amplitudes and rates, and the remainder of the frozen modes."""
        n, modal = at.n, at.s + self.factors * at.n
        torque = _load(w, at.tau, aid.drive.shape[1])
        for matrix, values in ((aid.L, _load(w, at.q, n)), (aid.L, _load(w, at.v, n))):
            _store(w, modal, _product(matrix, values))
            modal += n
        _store(w, modal, _product(aid.drive, torque))

    def step(self, w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
        """Advance by one step of `count` evaluations."""
        n, m, modal = at.n, self.count, at.s + self.factors * at.n
        row = 0
        for stage in range(m):
            remainders = [modal + (3 + j) * n for j in range(stage)] or [modal + 2 * n]
            y, z = self._advanced(w, n, at.s + row * n, modal, remainders, aid)
            row += 3 + 2 * len(remainders)
            _store(w, at.q, _product(aid.S, y))
            _store(w, at.v, _product(aid.S, z))
            g = modal + (3 + stage) * n
            _store(w, g, _linear_forces(aid, y, z))
            evaluate(w)
            for k, value in enumerate(_product(aid.L, _load(w, at.a, n))):
                w[g + k] += value
        remainders = [modal + (3 + j) * n for j in range(m)]
        y, z = self._advanced(w, n, at.s + row * n, modal, remainders, aid)
        last = [basis(self.nodes, m, j, 1.0) for j in range(m)]
        ends = [
            sum(share * w[g + k] for share, g in zip(last, remainders, strict=True))
            for k in range(n)
        ]
        _store(w, at.q, _product(aid.S, y))
        _store(w, at.v, _product(aid.S, z))
        _store(w, modal, [*y, *z, *ends])

    @staticmethod
    def _advanced(
        w: Any, n: int, factors: int, modal: int, remainders: list[int], aid: Any
    ) -> tuple[list[Any], list[Any]]:
        """Amplitudes and rates of the modes by one stage's factors."""
        amplitudes, rates = [], []
        for k in range(n):
            y, z = w[modal + k], w[modal + n + k]
            stay, odd, swing = (w[factors + j * n + k] for j in range(3))
            by_y, by_z = stay * y + odd * z, swing * z - odd * float(aid.squares[k]) * y
            for j, g in enumerate(remainders):
                by_y += w[factors + (3 + 2 * j) * n + k] * w[g + k]
                by_z += w[factors + (4 + 2 * j) * n + k] * w[g + k]
            amplitudes.append(by_y)
            rates.append(by_z)
        return amplitudes, rates


def _product(matrix: Any, x: list[Any]) -> list[Any]:
    return [sum(float(part) * value for part, value in zip(row, x, strict=True)) for row in matrix]


def _load(w: Any, first: int, n: int) -> list[Any]:
    return [w[first + i] for i in range(n)]


def _store(w: Any, first: int, values: list[Any]) -> None:
    for i, value in enumerate(values):
        w[first + i] = value


def _linear_forces(aid: Any, y: list[Any], z: list[Any]) -> list[Any]:
    """w^2 y + d z, the linear forces that the propagator integrates."""
    numbers = zip(aid.squares.tolist(), aid.decays.tolist(), y, z, strict=True)
    return [square * x + decay * rate for square, decay, x, rate in numbers]
