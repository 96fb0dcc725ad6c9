"""What is compiled of a method does what the method does."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import compile_arm, stepping
from dynamics.integrators import INTEGRATORS
from dynamics.lowering import expanded
from dynamics.stepping import jacobian_code, method_code

N = 3
AT = {"Q": 0, "V": N, "IMPLICIT": 2 * N, "ACC": 3 * N + 2, "H": 4 * N + 2, "SCRATCH": 4 * N + 3}
RECORDED = sorted(name for name, method in INTEGRATORS.items() if method.aid != "jacobian")
MODES = np.random.default_rng(1).uniform(-1.0, 1.0, (N, 2 + 2 * N))  # as they may be
MODES[:, 0] = 0.0, 3.0, 50.0


def evaluate(w: Any) -> None:
    """Some accelerations, different for everything that they may depend on."""
    for i in range(N):
        implicit = w[AT["IMPLICIT"]] * w[AT["IMPLICIT"] + 2 + i] + 3.0 * w[AT["IMPLICIT"] + 1]
        w[AT["ACC"] + i] = np.sin(w[i] + w[(i + 1) % N]) - w[N + i] ** 2 + implicit


def generated(integrator: str) -> dict[str, Callable[..., None]]:
    """What is generated, run as the Python it is written in, on one lane."""
    texts, marks = method_code(integrator, N, AT, MODES)
    marks = {"#evaluate": ["evaluate(w)"], **marks}
    names: dict[str, Any] = {
        "straight_line": lambda name, lanes, text, loose: lambda w: exec(text, {"w": w}),
        "evaluate": evaluate,
        "compiled": lambda function: function,
        "INTEGRATORS": INTEGRATORS,
        **{name: np.uint64(at) for name, at in AT.items()},
        "LANES": np.uint64(1),
        "N": np.uint64(N),
        "np": np,
    }
    for text in texts:
        exec(text, names)
    for name in ("prepare", "start", "step"):
        exec(expanded(f"def {name}(w):\n    #{name}\n    return", marks), names)
    return {name: names[name] for name in ("prepare", "start", "step")}


@pytest.mark.parametrize("integrator", RECORDED)
def test_straight_line_steps_are_the_methods(integrator: str) -> None:
    """Start and three steps on a workspace full of numbers: the same in every slot."""
    method, code = INTEGRATORS[integrator], generated(integrator)
    size = AT["SCRATCH"] + method.scratch(N)
    mine = np.random.default_rng(0).uniform(-1.0, 1.0, size)
    mine[AT["H"]] = 0.1
    theirs = mine.copy()
    places = [AT[name] for name in ("Q", "V", "ACC", "IMPLICIT", "SCRATCH")]
    code["prepare"](mine)
    method.prepare(theirs, 0.1, 1, N, AT["SCRATCH"], MODES)
    for name in ("start", "step", "step", "step"):
        code[name](mine)
        getattr(method, name)(theirs, 0.1, evaluate, 1, N, *places, MODES)
        assert_allclose(mine, theirs, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("integrator", RECORDED)
def test_a_stretch_needs_no_slot_that_it_has_overwritten(integrator: str) -> None:
    """Every slot is read before it is written, once at most."""
    for text in method_code(integrator, N, AT, MODES)[0]:
        written: set[str] = set()
        for line in text.splitlines():
            target, _, value = (part.strip() for part in line.partition("="))
            assert value not in written
            if target.startswith("w["):
                assert target not in written
                written.add(target)


def test_a_jacobian_too_long_to_compile_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """With what to take instead; one operation fewer is not."""
    model = compile_arm("slim")
    count = model.jacobian_graph.n_instructions()
    inputs = [0, 10, 20, 30, 40]
    monkeypatch.setattr(stepping, "LONGEST", count)
    assert "AID = straight_line(" in jacobian_code(model, inputs, 50)
    monkeypatch.setattr(stepping, "LONGEST", count - 1)
    with pytest.raises(ValueError, match=f"takes {count} operations .* 'midpoint'"):
        jacobian_code(model, inputs, 50)
