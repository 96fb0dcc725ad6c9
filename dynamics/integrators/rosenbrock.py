"""Rosenbrock step: linearly implicit Runge-Kutta with the exact Jacobian of the accelerations.

`aid` is a function that writes da/dq and da/dv of the present state, row by row, to the start of
the scratch space. Coefficients are those of Shampine (1982), "Implementation of Rosenbrock
methods": order 4, A-stable, three evaluations and one Jacobian per step.
"""

import numpy as np

GAMMA = 0.5
INSIDE = np.array([[0, 0, 0], [2, 0, 0], [48 / 25, 6 / 25, 0], [48 / 25, 6 / 25, 0]])
COUPLING = np.array([[0, 0, 0], [-8, 0, 0], [372 / 25, 12 / 5, 0], [-112 / 125, -54 / 125, -2 / 5]])
WEIGHTS = np.array([19 / 9, 1 / 2, 25 / 108, 125 / 108])


def factorize(w, h, lanes, n, s):  # type: ignore[no-untyped-def]
    """Write the LU factors of 1 - g h da/dv - g^2 h^2 da/dq, without pivoting, after the Jacobians.

    g is GAMMA; the factors' first slot is s + 2 (n / lanes) n.
    """
    m = n // lanes
    square = n * m
    lu = s + square + square
    first = w.dtype.type(GAMMA) * h
    for i in range(square):
        w[lu + i] = -first * (w[s + square + i] + first * w[s + i])
    for i in range(m):
        for b in range(lanes):
            w[lu + (i * m + i) * lanes + b] += w.dtype.type(1.0)
    for k in range(m):
        for i in range(k + np.uint64(1), m):
            for b in range(lanes):
                w[lu + (i * m + k) * lanes + b] /= w[lu + (k * m + k) * lanes + b]
            for j in range(k + np.uint64(1), m):
                for b in range(lanes):
                    pivot_row = w[lu + (k * m + j) * lanes + b]
                    w[lu + (i * m + j) * lanes + b] -= w[lu + (i * m + k) * lanes + b] * pivot_row


def solve(w, lanes, n, lu, x):  # type: ignore[no-untyped-def]
    """Solve L U y = x in place; `lu` and `x` are first slots."""
    m = n // lanes
    for i in range(m):
        for j in range(i):
            for b in range(lanes):
                w[x + i * lanes + b] -= w[lu + (i * m + j) * lanes + b] * w[x + j * lanes + b]
    for k in range(m):
        i = m - np.uint64(1) - k
        for j in range(i + np.uint64(1), m):
            for b in range(lanes):
                w[x + i * lanes + b] -= w[lu + (i * m + j) * lanes + b] * w[x + j * lanes + b]
        for b in range(lanes):
            w[x + i * lanes + b] /= w[lu + (i * m + i) * lanes + b]


def rosenbrock(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Rosenbrock step with stages (dq, dv) of (1/(g h) - J) stage = f + coupling.

    dq is eliminated, so that each stage solves one system of n equations for dv.
    """
    lanes, n, q, v, a, s = at.lanes, at.n, at.q, at.v, at.a, at.s
    kind = w.dtype.type
    m = n // lanes
    square = n * m
    lu, stages = s + square + square, s + square + square + square
    q0, v0 = stages + np.uint64(8) * n, stages + np.uint64(9) * n
    first = kind(GAMMA) * h
    aid(w)
    factorize(w, h, lanes, n, s)
    for i in range(n):
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
    for k in range(4):
        dq = stages + np.uint64(2 * k) * n
        dv = dq + n
        if k < 3:  # the last stage reuses the third's evaluation
            for i in range(n):
                w[q + i] = w[q0 + i]
                w[v + i] = w[v0 + i]
            for j in range(k):
                earlier = stages + np.uint64(2 * j) * n
                for i in range(n):
                    w[q + i] += kind(INSIDE[k, j]) * w[earlier + i]
                    w[v + i] += kind(INSIDE[k, j]) * w[earlier + n + i]
            evaluate(w)
        for i in range(n):
            w[dq + i] = w[v + i]
            w[dv + i] = w[a + i]
        for j in range(k):
            earlier = stages + np.uint64(2 * j) * n
            coupling = kind(COUPLING[k, j]) / h
            for i in range(n):
                w[dq + i] += coupling * w[earlier + i]
                w[dv + i] += coupling * w[earlier + n + i]
        for i in range(m):
            for j in range(m):
                for b in range(lanes):
                    w[dv + i * lanes + b] += (
                        first * w[s + (i * m + j) * lanes + b] * w[dq + j * lanes + b]
                    )
        solve(w, lanes, n, lu, dv)
        for i in range(n):
            w[dv + i] *= first
            w[dq + i] = first * (w[dq + i] + w[dv + i])
    for i in range(n):
        w[q + i] = w[q0 + i]
        w[v + i] = w[v0 + i]
    for k in range(4):
        stage = stages + np.uint64(2 * k) * n
        for i in range(n):
            w[q + i] += kind(WEIGHTS[k]) * w[stage + i]
            w[v + i] += kind(WEIGHTS[k]) * w[stage + n + i]
