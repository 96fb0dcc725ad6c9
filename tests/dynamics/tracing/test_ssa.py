"""Straight-line code evaluates its graph to the last bits."""

import math
from collections.abc import Callable
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics.backends.numba_llvm.module_text import straight_line_text
from dynamics.backends.numba_llvm.program import cached_module
from dynamics.backends.numba_llvm.stepper_entries import LANES
from dynamics.tracing.function import traced

FUNCTIONS = '''"""Elementary functions."""
from numba import njit
from dynamics.backends.numba_llvm.vector_code import straight_line
LANES = {lanes}

{function}

@njit
def evaluate(x, w, out):
    for row in range(x.size // {lanes}):
        for b in range({lanes}):
            w[b] = x[row * {lanes} + b]
        elementary(w)
        for b in range({lanes}):
            for k in range(3):
                out[k, row * {lanes} + b] = w[(1 + k) * {lanes} + b]
'''


@pytest.fixture(scope="module", params=[1, LANES])
def elementary(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[np.ndarray], np.ndarray]:
    """Generated code for sin, cos and tanh, one row of the result each."""
    lanes = request.param
    x = ca.SX.sym("x")
    graph = ca.Function("elementary", [x], [ca.vertcat(ca.sin(x), ca.cos(x), ca.tanh(x))])
    function = straight_line_text(traced("elementary", graph, [0], 1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXARM_CACHE", str(tmp_path_factory.mktemp("functions")))
        source = FUNCTIONS.format(function=function, lanes=lanes)
        module: ModuleType = cached_module(f"elementary_{lanes}", lambda: source)

    def evaluate(values: np.ndarray) -> np.ndarray:
        padded = np.resize(values, -(-values.size // LANES) * LANES)
        out = np.empty((3, padded.size))
        module.evaluate(padded, np.empty(4 * lanes), out)
        return out[:, : values.size]

    return evaluate


RNG = np.random.default_rng(0)
ANGLES = {
    "small": 10.0 ** RNG.uniform(-300, 0, 4000) * RNG.choice([-1.0, 1.0], 4000),
    "a few turns": RNG.uniform(-20.0, 20.0, 20_000),
    "many turns": RNG.uniform(-1e4, 1e4, 20_000),
    "near zeros": np.pi / 2 * np.arange(-6000, 6000) + RNG.normal(0.0, 1e-9, 12_000),
}
Elementary = Callable[[np.ndarray], np.ndarray]


@pytest.mark.parametrize("angles", ANGLES.values(), ids=ANGLES)
def test_sine_and_cosine_are_accurate_to_the_last_bits(
    elementary: Elementary, angles: np.ndarray
) -> None:
    sine, cosine, _ = elementary(angles)

    assert np.abs(sine - [math.sin(x) for x in angles]).max() < 4e-16
    assert np.abs(cosine - [math.cos(x) for x in angles]).max() < 4e-16


def test_the_root_of_a_square_is_an_absolute_value_and_comparisons_give_numbers() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    outputs = ca.vertcat(ca.sqrt(x * x), x < y, x <= y, ca.fmin(x, y), ca.fmax(x, y))
    statements = "\n".join(traced("f", ca.Function("f", [x, y], [outputs]), [0, 1], 2).lines)
    scope: dict[str, Any] = {
        "less": lambda a, b: float(a < b),
        "at_most": lambda a, b: float(a <= b),
    }

    assert "sqrt" not in statements
    for values in ([-2.0, 1.0], [1.0, -2.0], [1.0, 1.0]):
        a, b = values
        w = [*values, 0.0, 0.0, 0.0, 0.0, 0.0]
        exec(statements, {**scope, "w": w})
        assert w[2:] == [abs(a), a < b, a <= b, min(a, b), max(a, b)]


def test_sine_and_cosine_keep_twelve_digits_after_many_turns(elementary: Elementary) -> None:
    angles = RNG.uniform(-1e8, 1e8, 20_000)
    sine, cosine, _ = elementary(angles)

    assert np.abs(sine - np.sin(angles)).max() < 1e-12
    assert np.abs(cosine - np.cos(angles)).max() < 1e-12


def test_small_sines_keep_their_relative_digits(elementary: Elementary) -> None:
    sine, _, tanh = elementary(ANGLES["small"])

    assert_allclose(sine, [math.sin(x) for x in ANGLES["small"]], rtol=4e-16)
    assert_allclose(tanh, [math.tanh(x) for x in ANGLES["small"]], rtol=2e-15)


def test_tanh_is_accurate_for_small_and_large_arguments(elementary: Elementary) -> None:
    x = np.concatenate([RNG.uniform(-25.0, 25.0, 20_000), [0.0, 19.99, 20.01, -1e3, 1e300]])
    _, _, tanh = elementary(x)

    assert_allclose(tanh, [math.tanh(value) for value in x], rtol=2e-15)
    assert np.abs(tanh).max() <= 1.0


def test_a_non_finite_argument_gives_nan_in_its_own_lane_only(elementary: Elementary) -> None:
    """Except tanh at infinity, which is one."""
    values = elementary(np.array([np.nan, 0.5, np.inf, -np.inf]))

    assert np.all(np.isnan(values[:, 0]))
    assert_allclose(values[:, 1], [math.sin(0.5), math.cos(0.5), math.tanh(0.5)], rtol=1e-15)
    assert np.all(np.isnan(values[:2, 2:]))
    assert values[2, 2:].tolist() == [1.0, -1.0]


def test_an_unknown_operation_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match=r"No code for CasADi operation \d+"):
        traced("f", ca.Function("f", [x], [ca.exp(x)]), [0], 1)
