"""Integration methods as plain functions, and the table of them.

A method works in place on the flat workspace `w`; `Slots` are the indices of its values.
`evaluate(w)` writes the accelerations of the present coordinates and rates. A method's functions
are executed once on symbols, and the recorded operations are compiled; no branch may therefore
depend on a value. Only `prepare`, and all functions of a method that needs a Jacobian, are compiled
by numba directly, with loops over lanes.

`prepare(w, h, at, aid)` runs once when the step length h is known. `start(w, h, evaluate, at, aid)`
runs at the beginning of each call, under a new torque, and `step` with the same arguments once per
substep. Only q and v persist between calls, so a multistep method must start from the accelerations
themselves and, if it needs their rate, from a second evaluation a fraction of a step later. `aid`
is None, the arm's modes, the longest step that each coordinate stands without implicit forces, or
a function that writes the Jacobian, as `Integrator.aid` specifies.

An implicit method takes elastic and linear damping forces implicitly and all others at an
extrapolated state: `evaluate` solves (M + W) a = f(q, v) + W guess with W = k K + c C. The weights
k and c, one each per coordinate, are stored at `implicit`, followed by the guess. Coordinates that
K or C couple have equal weights. Each evaluation is one linear solve.
"""

from collections.abc import Callable
from dataclasses import dataclass

from dynamics.integrators.exponential import GaussStep, basis, prepare_nodes, pushes, response
from dynamics.integrators.newmark import (
    extrapolated_midpoint,
    generalized_alpha,
    midpoint,
    numerov,
    prepare_numerov,
    start_extrapolated_midpoint,
    start_generalized_alpha,
    start_midpoint,
    start_numerov,
)
from dynamics.integrators.rosenbrock import factorize, rosenbrock, solve


def prepare_nothing(w, h, at, aid):  # type: ignore[no-untyped-def]
    """Do nothing: the method has no constants that depend on the step length."""


def start_nothing(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Do nothing: a one-step method has no state to initialise."""


def euler(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Semi-implicit Euler: the new rates advance the coordinates. Order 1, omega h <= 2."""
    evaluate(w)
    for i in range(at.n):
        w[at.v + i] += h * w[at.a + i]
        w[at.q + i] += h * w[at.v + i]


def rk4(w, h, evaluate, at, aid):  # type: ignore[no-untyped-def]
    """Classical Runge-Kutta, order 4; stable on an undamped mode up to omega h = 2.828."""
    n, q, v, a = at.n, at.q, at.v, at.a
    q0, v0, dq, dv = (at.s + k * n for k in range(4))
    evaluate(w)
    for i in range(n):
        w[q0 + i] = w[q + i]
        w[v0 + i] = w[v + i]
        w[dq + i] = w[v + i]
        w[dv + i] = w[a + i]
        w[q + i] = w[q0 + i] + 0.5 * h * w[v + i]
        w[v + i] = w[v0 + i] + 0.5 * h * w[a + i]
    for length in (0.5 * h, h):
        evaluate(w)
        for i in range(n):
            w[dq + i] += 2.0 * w[v + i]
            w[dv + i] += 2.0 * w[a + i]
            w[q + i] = w[q0 + i] + length * w[v + i]
            w[v + i] = w[v0 + i] + length * w[a + i]
    evaluate(w)
    sixth = h / 6.0
    for i in range(n):
        w[q + i] = w[q0 + i] + sixth * (w[dq + i] + w[v + i])
        w[v + i] = w[v0 + i] + sixth * (w[dv + i] + w[a + i])


@dataclass(frozen=True)
class Integrator:
    """Functions of a method, and its order, stability limit and cost."""

    step: Callable[..., None]
    start: Callable[..., None]
    order: int
    limit: float  # largest stable omega h on an undamped mode
    per_step: int = 1  # evaluations of the accelerations per step
    per_call: int = 0  # further evaluations per call, in `start`
    implicit: bool = False  # stiffness and damping are part of the mass matrix in `evaluate`
    aid: str = "none"  # argument beside `evaluate`: "modes", "explicit steps" or "jacobian"
    scratch: Callable[[int], int] = lambda n: 4 * n  # number of values per lane at `s`
    kept: Callable[[int], int] = lambda n: 0  # number of leading scratch values kept between steps
    prepare: Callable[..., None] = prepare_nothing
    helpers: tuple[Callable[..., object], ...] = ()  # called by functions that numba compiles

    def evaluations(self, steps: int) -> int:
        """Evaluations of the accelerations in a call with this many steps."""
        return self.per_step * steps + self.per_call


def usable(n: int, spatial: bool) -> list[str]:
    """Methods for an arm of n coordinates; on a spatial base these are new after every step."""
    return [name for name, method in INTEGRATORS.items() if not (spatial and method.kept(n))]


def _exponential(count: int) -> Integrator:
    """Exponential step with a number of Gauss nodes; order 2, from its start under a new torque."""
    gauss = GaussStep(count)
    nodes = gauss.nodes

    def prepare(w, h, at, aid):  # type: ignore[no-untyped-def]
        prepare_nodes(w, h, at, aid, nodes)

    prepare.__qualname__ += f"_{count}"  # cached machine code is linked by name
    return Integrator(
        gauss.step, gauss.start, order=2, limit=UNLIMITED, per_step=count, aid="modes",
        scratch=lambda n: gauss.scratch * n, kept=lambda n: gauss.scratch * n, prepare=prepare,
        helpers=(response, basis, pushes, prepare_nodes),
    )  # fmt: skip


UNLIMITED = float("inf")
INTEGRATORS = {
    "rk4": Integrator(rk4, start_nothing, order=4, limit=2.828, per_step=4),
    "midpoint": Integrator(
        midpoint, start_midpoint, order=2, implicit=True, limit=UNLIMITED, per_call=1
    ),
    "numerov": Integrator(
        numerov, start_numerov, order=4, implicit=True, limit=UNLIMITED, per_call=2,
        aid="explicit steps", scratch=lambda n: 7 * n, kept=lambda n: 7 * n,
        prepare=prepare_numerov,
    ),
    "generalized-alpha": Integrator(
        generalized_alpha, start_generalized_alpha, order=2, implicit=True, limit=UNLIMITED,
        per_call=2, kept=lambda n: n,
    ),
    "exponential": _exponential(1),
    "exponential-2": _exponential(2),
    "exponential-3": _exponential(3),
    "exponential-4": _exponential(4),
    "rosenbrock": Integrator(
        rosenbrock, start_nothing, order=4, limit=UNLIMITED, per_step=3, aid="jacobian",
        scratch=lambda n: 10 * n + 3 * n * n, helpers=(factorize, solve),
    ),
    "euler": Integrator(euler, start_nothing, order=1, limit=2.0),
    "extrapolated-midpoint": Integrator(
        extrapolated_midpoint, start_extrapolated_midpoint, order=2, implicit=True,
        limit=UNLIMITED, per_call=1, kept=lambda n: 2 * n,
    ),
}  # fmt: skip
