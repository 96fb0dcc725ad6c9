"""The table of integration methods, one function per step of each.

A method works in place on the flat workspace `w`: `n` values (coordinates times lanes) of q, v and
a start at these offsets, scratch space at `s`. `evaluate(w)` writes the accelerations of the
present q and v. The functions are plain Python, with numbers typed to the workspace (float64 or
float32). But for what needs a Jacobian they run on symbols, so no branch may hang on a value;
stepping.py turns them, or their loops, into compiled code around an arm.

`prepare` runs when the length of the steps is known, `start` once per call, under a new torque,
`step` as often as there are substeps. Nothing but q and v outlives a call, so a method that
remembers must begin well: on true accelerations and, where it needs their rate, on one more
evaluation a little later.

An implicit method takes elastic and linear damping forces implicitly, all others at an
extrapolated state: `evaluate` then solves (M + W) a = f(q, v) + W guess with W = k K + c C, one
number each of k and c at `implicit`, then the guess. It stays linear and costs one solve a step.
"""

from collections.abc import Callable
from dataclasses import dataclass

from dynamics.exponential import exponential, prepare_exponential, start_exponential
from dynamics.newmark import (
    generalized_alpha,
    midpoint,
    numerov,
    start_generalized_alpha,
    start_midpoint,
    start_numerov,
)
from dynamics.rosenbrock import rosenbrock


def prepare_nothing(w, h, lanes, n, s, aid):  # type: ignore[no-untyped-def]
    """A method without numbers of its own for a length of steps."""


def start_nothing(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """A one-step method that needs no preparation."""


def euler(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
    """Semi-implicit Euler: new rates move the coordinates. Order 1, stable up to omega h = 2."""
    evaluate(w)
    for i in range(n):
        w[v + i] += h * w[a + i]
        w[q + i] += h * w[v + i]


def rk4(w, h, evaluate, lanes, n, q, v, a, implicit, s, aid):  # type: ignore[no-untyped-def]
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


@dataclass(frozen=True)
class Integrator:
    """A method: what it does each step, once per call and beforehand, and what to expect of it."""

    step: Callable[..., None]
    start: Callable[..., None]
    order: int
    limit: float  # largest omega h on an undamped mode
    per_step: int = 1  # evaluations of the accelerations
    per_call: int = 0  # those before the first step
    implicit: bool = False  # needs the graph with stiffness and damping in the mass matrix
    aid: str = "none"  # what it needs beside `evaluate`: "modes" of the arm, or its "jacobian"
    scratch: Callable[[int], int] = lambda n: 4 * n  # values per lane at `s`
    kept: Callable[[int], int] = lambda n: 0  # how many of them, the first, outlive a step
    prepare: Callable[..., None] = prepare_nothing

    def evaluations(self, steps: int) -> int:
        """Of a call of so many steps."""
        return self.per_step * steps + self.per_call


ALWAYS = float("inf")
INTEGRATORS = {
    "rk4": Integrator(rk4, start_nothing, order=4, limit=2.828, per_step=4),
    "midpoint": Integrator(
        midpoint, start_midpoint, order=2, implicit=True, limit=ALWAYS, per_call=1
    ),
    "numerov": Integrator(
        numerov, start_numerov, order=4, implicit=True, limit=2.449, per_call=2,
        scratch=lambda n: 5 * n, kept=lambda n: 5 * n,
    ),
    "generalized-alpha": Integrator(
        generalized_alpha, start_generalized_alpha, order=2, implicit=True, limit=ALWAYS,
        per_call=2, kept=lambda n: n,
    ),
    "exponential": Integrator(
        exponential, start_exponential, order=2, limit=ALWAYS, per_call=1, aid="modes",
        scratch=lambda n: 11 * n, kept=lambda n: 11 * n, prepare=prepare_exponential,
    ),
    "rosenbrock": Integrator(
        rosenbrock, start_nothing, order=4, limit=ALWAYS, per_step=3, aid="jacobian",
        scratch=lambda n: 10 * n + 3 * n * n,
    ),
    "euler": Integrator(euler, start_nothing, order=1, limit=2.0),
}  # fmt: skip
