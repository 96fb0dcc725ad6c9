"""The table of integration methods, one function per step of each.

A method works in place on the flat workspace `w`, whose `Slots` say where its values are;
`evaluate(w)` writes the accelerations of the present coordinates and rates. The functions are plain
Python. They run once on symbols, so no branch may depend on a value; only a method that needs a
Jacobian is compiled as it stands, loops over lanes and all.

`prepare` runs when the length h of the steps is known, `start` once per call, under a new torque,
`step` as often as there are substeps. Nothing but q and v outlives a call, so a method that
remembers must begin well: on true accelerations and, where it needs their rate, on one more
evaluation a little later. `aid` is what the entry of the table says: None, the arm's modes, or
a function that writes its Jacobian.

An implicit method takes elastic and linear damping forces implicitly, all others at an
extrapolated state: `evaluate` then solves (M + W) a = f(q, v) + W guess with W = k K + c C, one
number each of k and c at `implicit`, then the guess. It stays linear and costs one solve a step.
"""

from collections.abc import Callable
from dataclasses import dataclass

from dynamics.integrators.exponential import (
    exponential,
    prepare_exponential,
    propagator,
    start_exponential,
)
from dynamics.integrators.newmark import (
    generalized_alpha,
    midpoint,
    numerov,
    start_generalized_alpha,
    start_midpoint,
    start_numerov,
)
from dynamics.integrators.rosenbrock import factorize, rosenbrock, solve


def prepare_nothing(w, h, at, aid):  # type: ignore[no-untyped-def]
    """A method without numbers of its own for a length of steps."""


def start_nothing(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """A one-step method that needs no preparation."""


def euler(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Semi-implicit Euler: new rates move the coordinates. Order 1, stable up to omega h = 2."""
    evaluate(w)
    for i in range(at.n):
        w[at.v + i] += h * w[at.a + i]
        w[at.q + i] += h * w[at.v + i]


def rk4(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Classical Runge-Kutta, order 4; stable on an undamped mode up to omega h = 2.83."""
    n, q, v, a = at.n, at.q, at.v, at.a
    q0, v0, dq, dv = (at.s + k * n for k in range(4))
    evaluate(w)
    for i in range(n):
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
        w[dq + i] = w[v + i]
        w[dv + i] = w[a + i]
    for length, weight in ((0.5 * h, 2.0), (0.5 * h, 2.0), (h, 1.0)):
        for i in range(n):
            w[q + i] = w[q0 + i] + length * w[v + i]
            w[v + i] = w[v0 + i] + length * w[a + i]
        evaluate(w)
        for i in range(n):
            w[dq + i] += weight * w[v + i]
            w[dv + i] += weight * w[a + i]
    sixth = h / 6.0
    for i in range(n):
        w[q + i] = w[q0 + i] + sixth * w[dq + i]
        w[v + i] = w[v0 + i] + sixth * w[dv + i]


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
    helpers: tuple[Callable[..., object], ...] = ()  # that functions compiled as they stand call

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
        helpers=(propagator,),
    ),
    "rosenbrock": Integrator(
        rosenbrock, start_nothing, order=4, limit=ALWAYS, per_step=3, aid="jacobian",
        scratch=lambda n: 10 * n + 3 * n * n, helpers=(factorize, solve),
    ),
    "euler": Integrator(euler, start_nothing, order=1, limit=2.0),
}  # fmt: skip
