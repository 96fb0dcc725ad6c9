"""One step of each integration method, and the table of them.

A method works in place on the flat workspace `w`: `n` values (coordinates times lanes) of q, v and
a start at these offsets, scratch space for four times as many at `s`. `evaluate(w)` writes the
accelerations of the present q and v. The functions are plain Python, with numbers typed to the
workspace (float64 or float32); a generated module compiles them around its arm.

An implicit method takes elastic and linear damping forces implicitly, all others at an
extrapolated state: `evaluate` then solves (M + W) a = f(q, v) + W guess with W = k K + c C, one
number each of k and c at `implicit`, then the guess. It stays linear and costs one solve a step.
"""

from collections.abc import Callable
from dataclasses import dataclass


def rk4(w, h, evaluate, lanes, n, q, v, a, implicit, s):  # type: ignore[no-untyped-def]
    """Classical Runge-Kutta, order 4; stable on an undamped mode up to omega h = 2.83."""
    q0, v0, dq, dv = s, s + n, s + n + n, s + n + n + n
    two = w.dtype.type(2.0)
    half = w.dtype.type(0.5) * h
    evaluate(w)
    for i in range(n):
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
        w[dq + i] = w[v + i]
        w[dv + i] = w[a + i]
        w[q + i] = w[q0 + i] + half * w[v + i]
        w[v + i] = w[v0 + i] + half * w[a + i]
    evaluate(w)
    for i in range(n):
        w[dq + i] += two * w[v + i]
        w[dv + i] += two * w[a + i]
        w[q + i] = w[q0 + i] + half * w[v + i]
        w[v + i] = w[v0 + i] + half * w[a + i]
    evaluate(w)
    for i in range(n):
        w[dq + i] += two * w[v + i]
        w[dv + i] += two * w[a + i]
        w[q + i] = w[q0 + i] + h * w[v + i]
        w[v + i] = w[v0 + i] + h * w[a + i]
    evaluate(w)
    sixth = h / w.dtype.type(6.0)
    for i in range(n):
        w[q + i] = w[q0 + i] + sixth * (w[dq + i] + w[v + i])
        w[v + i] = w[v0 + i] + sixth * (w[dv + i] + w[a + i])


def start_nothing(w, h, evaluate, lanes, n, q, v, a, implicit, s):  # type: ignore[no-untyped-def]
    """A one-step method that needs no preparation."""


def start_midpoint(w, h, evaluate, lanes, n, q, v, a, implicit, s):  # type: ignore[no-untyped-def]
    """Weights of the implicit forces, and first accelerations from a guess of none."""
    half = w.dtype.type(0.5) * h
    for b in range(lanes):
        w[implicit + b] = half * half
        w[implicit + lanes + b] = half
    for i in range(n):
        w[implicit + lanes + lanes + i] = w.dtype.type(0.0)
    evaluate(w)


def midpoint(w, h, evaluate, lanes, n, q, v, a, implicit, s):  # type: ignore[no-untyped-def]
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


@dataclass(frozen=True)
class Integrator:
    """A method: what it does once per call, what it does each step, and what to expect of it."""

    step: Callable[..., None]
    start: Callable[..., None]
    order: int
    implicit: bool  # needs the graph with stiffness and damping in the mass matrix
    limit: float  # largest omega h on an undamped mode


INTEGRATORS = {
    "rk4": Integrator(rk4, start_nothing, order=4, implicit=False, limit=2.828),
    "midpoint": Integrator(midpoint, start_midpoint, order=2, implicit=True, limit=float("inf")),
}
