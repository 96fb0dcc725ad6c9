"""Steps with implicit elastic and linear damping forces: one linear solve each.

Variants of Newmark's method, q += h v + h^2 ((1/2 - beta) a + beta a_new). table.py describes the
arguments; docs/theory.md has the formulas.
"""

import numpy as np

PROBE = 1.0 / 64.0  # fraction of a step over which the rate of the accelerations is measured

# generalized-alpha (Chung & Hulbert 1993)
RHO = 0.9  # [-] amplification per step of an infinitely fast mode
ALPHA_M = (2.0 * RHO - 1.0) / (RHO + 1.0)
ALPHA_F = RHO / (RHO + 1.0)
GAMMA = 0.5 + ALPHA_F - ALPHA_M
BETA = 0.25 * (GAMMA + 0.5) ** 2

# numerov
FAST_BETA = 0.4  # [-] of coordinates too fast for the step; stable from 1/4 on
EXPLICIT = 1.0 / 12.0  # [-] beta of the others
SAFE = 0.7  # of the stability limit, which changes with posture and rates


def set_weights(w, at, stiffness, damping):  # type: ignore[no-untyped-def]
    """Set equal weights of stiffness and damping in the implicit mass matrix."""
    for i in range(at.n):
        w[at.implicit + i] = stiffness
        w[at.implicit + at.n + i] = damping


def start_accelerations(w, h, evaluate, at):  # type: ignore[no-untyped-def]
    """Write the accelerations to `a` and h times their rate to `s`; uses 4 n scratch values."""
    n, q, v, a = at.n, at.q, at.v, at.a
    rate, q0, v0, a0 = (at.s + k * n for k in range(4))
    probe = PROBE * h
    set_weights(w, at, 0.0, 0.0)
    for i in range(n):
        w[at.implicit + 2 * n + i] = 0.0
    evaluate(w)
    for i in range(n):
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
        w[a0 + i] = w[a + i]
        w[q + i] += probe * (w[v + i] + 0.5 * probe * w[a + i])
        w[v + i] += probe * w[a + i]
    evaluate(w)
    for i in range(n):
        w[rate + i] = (w[a + i] - w[a0 + i]) / PROBE
        w[q + i] = w[q0 + i]
        w[v + i] = w[v0 + i]
        w[a + i] = w[a0 + i]


def start_midpoint(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Set the implicit weights, and evaluate first accelerations with a zero guess."""
    half = 0.5 * h
    set_weights(w, at, half * half, half)
    for i in range(at.n):
        w[at.implicit + 2 * at.n + i] = 0.0
    evaluate(w)


def midpoint(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Implicit-force midpoint rule: order 2, A-stable on the elastic part, no numerical damping.

    It guesses the last accelerations.
    """
    for i in range(at.n):
        w[at.implicit + 2 * at.n + i] = w[at.a + i]
    midpoint_step(w, h, evaluate, at, at.s)


def start_extrapolated_midpoint(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Set the implicit weights, evaluate first accelerations, and a zero change of them."""
    start_midpoint(w, h, evaluate, at, aid)
    for i in range(at.n):
        w[at.s + i] = 0.0
        w[at.s + at.n + i] = 2.0


def extrapolated_midpoint(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Implicit-force midpoint rule that extrapolates the last accelerations by their change.

    Linear forces do not depend on the guess; its error, of h^2 where the last accelerations alone
    err by h, reaches those of rates and posture.
    """
    n, change, steps = at.n, at.s, at.s + at.n
    for i in range(n):
        w[at.implicit + 2 * n + i] = w[at.a + i] + w[change + i]
        w[change + i] = w[at.a + i]
    midpoint_step(w, h, evaluate, at, at.s + 2 * n)
    for i in range(n):
        w[change + i] = w[steps + i] * (w[at.a + i] - w[change + i])
        w[steps + i] = 1.0


def midpoint_step(w, h, evaluate, at, scratch):  # type: ignore[no-untyped-def]
    """Midpoint rule from the guess; uses 2 n scratch values."""
    n, q, v, a = at.n, at.q, at.v, at.a
    guess, v0, q0 = at.implicit + 2 * n, scratch, scratch + n
    half = 0.5 * h
    for i in range(n):
        w[q0 + i] = w[q + i] + half * w[v + i]
        w[v0 + i] = w[v + i]
        w[q + i] = w[q0 + i] + half * half * w[guess + i]
        w[v + i] += half * w[guess + i]
    evaluate(w)
    for i in range(n):
        w[v + i] = w[v0 + i] + h * w[a + i]
        w[q + i] = w[q0 + i] + half * w[v + i]


def prepare_numerov(w, h, at, aid):  # type: ignore[no-untyped-def]
    """Store 1 for slow and 0 for fast coordinates, and h beta; compiled by numba, not recorded.

    `aid` holds the step [s] from which each coordinate is fast.
    """
    for k in range(np.uint64(aid.size)):
        fast = 1.0 * (h > aid[k])
        for b in range(k * at.lanes, (k + np.uint64(1)) * at.lanes):
            w[at.s + np.uint64(5) * at.n + b] = 1.0 - fast
            w[at.s + np.uint64(6) * at.n + b] = h * (EXPLICIT + fast * (FAST_BETA - EXPLICIT))


def start_numerov(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Shifted rates u = v + h^2/12 da/dt, and differences of the accelerations: h da/dt, 0, 0."""
    n = at.n
    first, second, third, shifted, fresh, slow, hbeta = (at.s + k * n for k in range(7))
    twelfth = 1.0 / 12.0 * h
    start_accelerations(w, h, evaluate, at)
    for i in range(n):
        w[first + i] *= w[slow + i]
        w[second + i] = 0.0
        w[third + i] = 0.0
        w[shifted + i] = w[at.v + i] + twelfth * w[first + i]
        w[fresh + i] = 1.0
        w[at.implicit + i] = h * w[hbeta + i]
        w[at.implicit + n + i] = 0.5 * h - 2.0 * twelfth * w[slow + i]


def numerov(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Newmark's method with beta = 1/12 on u = v + h^2/12 da/dt: order 4, omega h <= 2.449.

    The coordinates follow Numerov's formula, the rates the Euler-Maclaurin trapezoidal rule. The
    guess extrapolates the accelerations by their backward differences; in the first step only a
    and da/dt are known, which `fresh` marks with 1. Coordinates too fast for the step follow
    Newmark's method with beta = FAST_BETA on u = v and linear extrapolation: order 2, A-stable.
    """
    n, q, v, a = at.n, at.q, at.v, at.a
    first, second, third, shifted, fresh, slow, hbeta = (at.s + k * n for k in range(7))
    guess = at.implicit + 2 * n
    half, twelfth = 0.5 * h, 1.0 / 12.0 * h
    for i in range(n):
        w[second + i] += w[third + i]
        w[first + i] += w[second + i]
        w[guess + i] = w[a + i] + w[first + i]
        w[q + i] += h * (w[shifted + i] + half * w[a + i] + w[hbeta + i] * w[first + i])
        w[shifted + i] += half * (w[a + i] + w[guess + i])
        shift = w[slow + i] * (w[first + i] + 0.5 * w[second + i])
        w[v + i] = w[shifted + i] - twelfth * shift
    evaluate(w)
    for i in range(n):
        error = w[a + i] - w[guess + i]
        late = w[slow + i] * error
        rate_error = w[fresh + i] * (PROBE / (1.0 - PROBE)) * late  # in the first da/dt
        w[first + i] += error
        w[second + i] += (1.0 + w[fresh + i]) * late + rate_error + rate_error
        w[third + i] += (1.0 - w[fresh + i]) * late
        w[fresh + i] = 0.0
        w[q + i] += h * (w[hbeta + i] * error - twelfth * rate_error)
        w[shifted + i] += half * error - twelfth * rate_error
        shift = w[slow + i] * (w[first + i] + 0.5 * w[second + i])
        w[v + i] = w[shifted + i] - twelfth * shift
        w[at.implicit + n + i] = half - 1.5 * twelfth * w[slow + i]


def start_generalized_alpha(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Set auxiliary accelerations b = a + (ALPHA_M - ALPHA_F) h da/dt, and the first guess.

    The guess holds the accelerations (1 - ALPHA_F) h after the start.
    """
    within = (1.0 - ALPHA_F) / (1.0 - ALPHA_M) * h
    start_accelerations(w, h, evaluate, at)
    set_weights(w, at, within * BETA * h, within * GAMMA)
    for i in range(at.n):
        rate = w[at.s + i]
        w[at.s + i] = w[at.a + i] + (ALPHA_M - ALPHA_F) * rate
        w[at.a + i] += (1.0 - ALPHA_F) * rate


def generalized_alpha(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Generalized-alpha: order 2, A-stable on the elastic part, damps modes too fast for the step.

    (1 - ALPHA_M) b_new + ALPHA_M b are the accelerations at the time ALPHA_F h before the end of
    the step.
    """
    n, q, v, a = at.n, at.q, at.v, at.a
    guess, b, q0, v0 = at.implicit + 2 * n, at.s, at.s + n, at.s + 2 * n
    share = 1.0 / (1.0 - ALPHA_M)
    inside = (1.0 - ALPHA_F) * h
    for i in range(n):
        new = share * (w[a + i] - ALPHA_M * w[b + i])
        w[guess + i] = w[a + i]
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
        w[q + i] += inside * (w[v + i] + h * ((0.5 - BETA) * w[b + i] + BETA * new))
        w[v + i] += inside * ((1.0 - GAMMA) * w[b + i] + GAMMA * new)
    evaluate(w)
    for i in range(n):
        new = share * (w[a + i] - ALPHA_M * w[b + i])
        w[q + i] = w[q0 + i] + h * (w[v0 + i] + h * ((0.5 - BETA) * w[b + i] + BETA * new))
        w[v + i] = w[v0 + i] + h * ((1.0 - GAMMA) * w[b + i] + GAMMA * new)
        w[b + i] = new
