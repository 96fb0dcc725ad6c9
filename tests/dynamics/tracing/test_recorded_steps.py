"""Recorded steps give the results of the integrators' own functions."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics.integrators.exponential import FrozenModes
from dynamics.integrators.slots import Slots
from dynamics.integrators.table import INTEGRATORS
from dynamics.tracing.function import Function
from dynamics.tracing.recorded_steps import EVALUATE, recorded

N = 3
AT = Slots(n=N, q=0, v=N, a=5 * N, implicit=2 * N, s=7 * N + 1, tau=6 * N)
H = 7 * N
RECORDED = sorted(name for name, method in INTEGRATORS.items() if method.aid != "jacobian")
RNG = np.random.default_rng(1)
MODES = FrozenModes(
    np.array([0.0, 3.0, 50.0]), RNG.uniform(-1.0, 1.0, N), *RNG.uniform(-1.0, 1.0, (3, N, N))
)


def aid(integrator: str) -> Any:
    """Modes, or steps that make one of three coordinates fast."""
    steps = np.array([0.2, 0.05, np.inf])
    return {"none": None, "modes": MODES, "explicit steps": steps}[INTEGRATORS[integrator].aid]


def evaluate(w: Any) -> None:
    """Artificial accelerations that depend on every value a method may pass."""
    for i in range(N):
        stiffness, damping, guess = (w[AT.implicit + k * N + i] for k in range(3))
        implicit = stiffness * guess + 3.0 * damping
        w[AT.a + i] = np.sin(w[i] + w[(i + 1) % N]) - w[N + i] ** 2 + implicit


def straight_line(function: Function) -> Callable[[Any], None]:
    text = "\n".join(function.lines)
    return lambda w: exec(text, {"w": w})


def replayed(part: str, integrator: str) -> Callable[[Any], None]:
    """A start or step of a method, run by its straight-line functions on one lane."""
    steps = recorded(part, getattr(INTEGRATORS[integrator], part), H, AT, aid(integrator))
    functions = {f.name: straight_line(f) for f in steps.functions} | {EVALUATE: evaluate}

    def run(w: Any) -> None:
        for name in steps.calls:
            functions[name](w)

    return run


@pytest.mark.parametrize("integrator", RECORDED)
def test_recorded_steps_equal_the_integrators_steps(integrator: str) -> None:
    """A start and three steps on a random workspace give equal values in every slot."""
    method, modes = INTEGRATORS[integrator], aid(integrator)
    mine = np.random.default_rng(0).uniform(-1.0, 1.0, AT.s + method.scratch(N))
    mine[H] = 0.1
    method.prepare(mine, 0.1, AT, modes)
    theirs = mine.copy()
    for part in ("start", "step", "step", "step"):
        replayed(part, integrator)(mine)
        getattr(method, part)(theirs, 0.1, evaluate, AT, modes)
        assert_allclose(mine, theirs, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("integrator", RECORDED)
def test_a_recorded_function_never_reads_a_slot_that_it_has_written(integrator: str) -> None:
    """It writes every slot once at most."""
    method = INTEGRATORS[integrator]
    for part in ("start", "step"):
        steps = recorded(part, getattr(method, part), H, AT, aid(integrator))
        for function in steps.functions:
            written: set[str] = set()
            for line in function.lines:
                target, _, value = (part.strip() for part in line.partition("="))
                assert value not in written
                if target.startswith("w["):
                    assert target not in written
                    written.add(target)
