"""Steps that take elastic and linear damping forces implicitly: one linear solve each.

Relatives of Newmark's method, q += h v + h^2 ((1/2 - beta) a + beta a_new). Arguments are those
that table.py describes; docs/theory.md has the formulas.
"""

LATER = 1.0 / 64.0  # of a step: where the rate of the accelerations is measured

# generalized-alpha (Chung & Hulbert 1993): what is left of an infinitely fast mode after one step
RHO = 0.9
ALPHA_M = (2.0 * RHO - 1.0) / (RHO + 1.0)
ALPHA_F = RHO / (RHO + 1.0)
GAMMA = 0.5 + ALPHA_F - ALPHA_M
BETA = 0.25 * (GAMMA + 0.5) ** 2


def weigh(w, at, stiffness, damping):  # type: ignore[no-untyped-def]
    """Set the weights of stiffness and damping in the mass matrix."""
    w[at.implicit] = stiffness
    w[at.implicit + 1] = damping


def set_out(w, h, evaluate, at):  # type: ignore[no-untyped-def]
    """True accelerations at `a`, and h times their rate at `s`; uses 3 n more scratch values."""
    n, q, v, a = at.n, at.q, at.v, at.a
    rate, q0, v0, a0 = (at.s + k * n for k in range(4))
    later = LATER * h
    weigh(w, at, 0.0, 0.0)
    for i in range(n):
        w[at.implicit + 2 + i] = 0.0
    evaluate(w)
    for i in range(n):
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
        w[a0 + i] = w[a + i]
        w[q + i] += later * (w[v + i] + 0.5 * later * w[a + i])
        w[v + i] += later * w[a + i]
    evaluate(w)
    for i in range(n):
        w[rate + i] = (w[a + i] - w[a0 + i]) / LATER
        w[q + i] = w[q0 + i]
        w[v + i] = w[v0 + i]
        w[a + i] = w[a0 + i]


def start_midpoint(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Weights of the implicit forces, and first accelerations from a guess of none."""
    half = 0.5 * h
    weigh(w, at, half * half, half)
    for i in range(at.n):
        w[at.implicit + 2 + i] = 0.0
    evaluate(w)


def midpoint(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Augmented-mass midpoint rule: order 2, A-stable on the elastic part, no numerical damping."""
    n, q, v, a = at.n, at.q, at.v, at.a
    guess, v0, q0 = at.implicit + 2, at.s, at.s + n
    half = 0.5 * h
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


def start_numerov(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Rates shifted by the rate of the accelerations; their higher differences begin at none."""
    n = at.n
    first, second, third, shifted, fresh = (at.s + k * n for k in range(5))
    twelfth = 1.0 / 12.0 * h
    set_out(w, h, evaluate, at)
    weigh(w, at, h * twelfth, 1.0 / 3.0 * h)
    for i in range(n):
        w[second + i] = 0.0
        w[third + i] = 0.0
        w[shifted + i] = w[at.v + i] + twelfth * w[first + i]
        w[fresh + i] = 1.0


def numerov(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Newmark's method with beta = 1/12 on u = v + h^2/12 da/dt: order 4, omega h <= 2.449.

    Numerov's formula for the coordinates, Euler and Maclaurin's trapezoidal rule for the rates.
    Accelerations are predicted by their backward differences; a fresh start knows a and da/dt.
    """
    n, q, v, a = at.n, at.q, at.v, at.a
    first, second, third, shifted, fresh = (at.s + k * n for k in range(5))
    guess = at.implicit + 2
    twelfth = 1.0 / 12.0 * h
    five = 5.0 * twelfth
    for i in range(n):
        w[second + i] += w[third + i]
        w[first + i] += w[second + i]
        w[guess + i] = w[a + i] + w[first + i]
        w[q + i] += h * (w[shifted + i] + five * w[a + i] + twelfth * w[guess + i])
        w[shifted + i] += 0.5 * h * (w[a + i] + w[guess + i])
        w[v + i] = w[shifted + i] - twelfth * (w[first + i] + 0.5 * w[second + i])
    evaluate(w)
    for i in range(n):
        missed = w[a + i] - w[guess + i]
        late = w[fresh + i] * (LATER / (1.0 - LATER)) * missed  # of the first da/dt
        w[first + i] += missed
        w[second + i] += (1.0 + w[fresh + i]) * missed + late + late
        w[third + i] += (1.0 - w[fresh + i]) * missed
        w[fresh + i] = 0.0
        w[q + i] += h * twelfth * (missed - late)
        w[shifted + i] += 0.5 * h * missed - twelfth * late
        w[v + i] = w[shifted + i] - twelfth * (w[first + i] + 0.5 * w[second + i])
    weigh(w, at, h * twelfth, 0.375 * h)


def start_generalized_alpha(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """The auxiliary accelerations belong a little beside the present, the first guess inside it."""
    within = (1.0 - ALPHA_F) / (1.0 - ALPHA_M) * h
    set_out(w, h, evaluate, at)
    weigh(w, at, within * BETA * h, within * GAMMA)
    for i in range(at.n):
        rate = w[at.s + i]
        w[at.s + i] = w[at.a + i] + (ALPHA_M - ALPHA_F) * rate
        w[at.a + i] += (1.0 - ALPHA_F) * rate


def generalized_alpha(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Order 2, A-stable on the elastic part, damps what the step cannot resolve.

    True accelerations (1 - ALPHA_M) b_new + ALPHA_M b at the time ALPHA_F before the step's end.
    """
    n, q, v, a = at.n, at.q, at.v, at.a
    guess, b, q0, v0 = at.implicit + 2, at.s, at.s + n, at.s + 2 * n
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
