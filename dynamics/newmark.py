"""Steps that take elastic and linear damping forces implicitly: one linear solve each.

Relatives of Newmark's method, q += h v + h^2 ((1/2 - beta) a + beta a_new). See integrators.py for
the arguments, docs/theory.md for the formulas.
"""

from numba.extending import register_jitable

LATER = 1.0 / 64.0  # of a step: where the rate of the accelerations is measured

# generalized-alpha (Chung & Hulbert 1993): what is left of an infinitely fast mode after one step
RHO = 0.9
ALPHA_M = (2.0 * RHO - 1.0) / (RHO + 1.0)
ALPHA_F = RHO / (RHO + 1.0)
GAMMA = 0.5 + ALPHA_F - ALPHA_M
BETA = 0.25 * (GAMMA + 0.5) ** 2


@register_jitable
def weigh(w, lanes, implicit, stiffness, damping):  # type: ignore[no-untyped-def]
    """Set the weights of stiffness and damping in the mass matrix."""
    for b in range(lanes):
        w[implicit + b] = stiffness
        w[implicit + lanes + b] = damping


@register_jitable(inline="always")  # or numba could not cache: a function goes in
def set_out(w, h, evaluate, lanes, n, q, v, a, implicit, s):  # type: ignore[no-untyped-def]
    """True accelerations at `a`, and h times their rate at `s`; uses 3 n more scratch values."""
    rate, q0, v0, a0 = s, s + n, s + n + n, s + n + n + n
    none = w.dtype.type(0.0)
    later = w.dtype.type(LATER) * h
    half = w.dtype.type(0.5) * later
    weigh(w, lanes, implicit, none, none)
    for i in range(n):
        w[implicit + lanes + lanes + i] = none
    evaluate(w)
    for i in range(n):
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
        w[a0 + i] = w[a + i]
        w[q + i] += later * (w[v + i] + half * w[a + i])
        w[v + i] += later * w[a + i]
    evaluate(w)
    for i in range(n):
        w[rate + i] = (w[a + i] - w[a0 + i]) / w.dtype.type(LATER)
        w[q + i] = w[q0 + i]
        w[v + i] = w[v0 + i]
        w[a + i] = w[a0 + i]


def start_midpoint(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Weights of the implicit forces, and first accelerations from a guess of none."""
    half = w.dtype.type(0.5) * h
    weigh(w, lanes, implicit, half * half, half)
    for i in range(n):
        w[implicit + lanes + lanes + i] = w.dtype.type(0.0)
    evaluate(w)


def midpoint(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Augmented-mass midpoint rule: order 2, A-stable on the elastic part, no numerical damping."""
    guess, v0, q0 = implicit + lanes + lanes, s, s + n
    half = w.dtype.type(0.5) * h
    for i in range(n):
        w[guess + i] = w[a + i]
        w[q0 + i] = w[q + i] + half * w[v + i]
        w[v0 + i] = w[v + i]
        w[q + i] = w[q0 + i] + half * half * w[a + i]
        w[v + i] += half * w[a + i]
    evaluate(w)
    for i in range(n):
        w[v + i] = w[v0 + i] + h * w[a + i]
        w[q + i] = w[q0 + i] + half * w[v + i]


def start_numerov(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Rates shifted by the rate of the accelerations; their higher differences begin at none."""
    first, second, third, shifted, fresh = s, s + n, s + n + n, s + n + n + n, s + n + n + n + n
    twelfth = w.dtype.type(1.0 / 12.0) * h
    set_out(w, h, evaluate, lanes, n, q, v, a, implicit, s)
    weigh(w, lanes, implicit, h * twelfth, w.dtype.type(1.0 / 3.0) * h)
    for i in range(n):
        w[second + i] = w.dtype.type(0.0)
        w[third + i] = w.dtype.type(0.0)
        w[shifted + i] = w[v + i] + twelfth * w[first + i]
        w[fresh + i] = w.dtype.type(1.0)


def numerov(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Newmark's method with beta = 1/12 on u = v + h^2/12 da/dt: order 4, omega h <= 2.449.

    Numerov's formula for the coordinates, Euler and Maclaurin's trapezoidal rule for the rates.
    Accelerations are predicted by their backward differences; a fresh start knows a and da/dt.
    """
    first, second, third, shifted, fresh = s, s + n, s + n + n, s + n + n + n, s + n + n + n + n
    guess = implicit + lanes + lanes
    one, half = w.dtype.type(1.0), w.dtype.type(0.5)
    twelfth = w.dtype.type(1.0 / 12.0) * h
    five = w.dtype.type(5.0) * twelfth
    for i in range(n):
        w[second + i] += w[third + i]
        w[first + i] += w[second + i]
        w[guess + i] = w[a + i] + w[first + i]
        w[q + i] += h * (w[shifted + i] + five * w[a + i] + twelfth * w[guess + i])
        w[shifted + i] += half * h * (w[a + i] + w[guess + i])
        w[v + i] = w[shifted + i] - twelfth * (w[first + i] + half * w[second + i])
    evaluate(w)
    for i in range(n):
        missed = w[a + i] - w[guess + i]
        late = w[fresh + i] * w.dtype.type(LATER / (1.0 - LATER)) * missed  # of the first da/dt
        w[first + i] += missed
        w[second + i] += (one + w[fresh + i]) * missed + late + late
        w[third + i] += (one - w[fresh + i]) * missed
        w[fresh + i] = w.dtype.type(0.0)
        w[q + i] += h * twelfth * (missed - late)
        w[shifted + i] += half * h * missed - twelfth * late
        w[v + i] = w[shifted + i] - twelfth * (w[first + i] + half * w[second + i])
    weigh(w, lanes, implicit, h * twelfth, w.dtype.type(0.375) * h)


def start_generalized_alpha(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """The auxiliary accelerations belong a little beside the present, the first guess inside it."""
    kind = w.dtype.type
    within = kind((1.0 - ALPHA_F) / (1.0 - ALPHA_M)) * h
    set_out(w, h, evaluate, lanes, n, q, v, a, implicit, s)
    weigh(w, lanes, implicit, within * kind(BETA) * h, within * kind(GAMMA))
    for i in range(n):
        rate = w[s + i]
        w[s + i] = w[a + i] + kind(ALPHA_M - ALPHA_F) * rate
        w[a + i] += kind(1.0 - ALPHA_F) * rate


def generalized_alpha(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Order 2, A-stable on the elastic part, damps what the step cannot resolve.

    True accelerations (1 - ALPHA_M) b_new + ALPHA_M b at the time ALPHA_F before the step's end.
    """
    guess, b, q0, v0 = implicit + lanes + lanes, s, s + n, s + n + n
    kind = w.dtype.type
    share = kind(1.0 / (1.0 - ALPHA_M))
    inside = kind(1.0 - ALPHA_F) * h
    for i in range(n):
        new = share * (w[a + i] - kind(ALPHA_M) * w[b + i])
        w[guess + i] = w[a + i]
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
        w[q + i] += inside * (w[v + i] + h * (kind(0.5 - BETA) * w[b + i] + kind(BETA) * new))
        w[v + i] += inside * (kind(1.0 - GAMMA) * w[b + i] + kind(GAMMA) * new)
    evaluate(w)
    for i in range(n):
        new = share * (w[a + i] - kind(ALPHA_M) * w[b + i])
        w[q + i] = w[q0 + i] + h * (
            w[v0 + i] + h * (kind(0.5 - BETA) * w[b + i] + kind(BETA) * new)
        )
        w[v + i] = w[v0 + i] + h * (kind(1.0 - GAMMA) * w[b + i] + kind(GAMMA) * new)
        w[b + i] = new
