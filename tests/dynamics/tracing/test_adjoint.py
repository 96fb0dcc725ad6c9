"""Adjoints and tangents of straight-line functions, held against CasADi's derivatives."""

import operator
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics import ARMS
from dynamics.tracing import graphs
from dynamics.tracing.adjoint import adjoint, tangent
from dynamics.tracing.function import Function, traced
from dynamics.tracing.traced_arm import TracedArm

OPERATIONS: dict[str, Callable[..., float]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "neg": operator.neg, "floor": np.floor, "rounded": np.floor, "sqrt": np.sqrt, "abs": abs,
    "min": min, "max": max, "less": operator.lt, "at_most": operator.le,
}  # fmt: skip


def run(function: Function, w: Any) -> Any:
    """The workspace after a function, one number per slot."""
    w, values = w.copy(), []
    for v, (op, args) in enumerate(function.code.statements):
        kind, _, number = op.partition(" ")
        if kind == "load":
            values.append(w[int(number)])
        elif kind == "const":
            values.append(float(number))
        else:
            values.append(float(OPERATIONS[op](*(values[a] for a in args))))
        for slot, value in function.stores.get(v, ()):
            w[slot] = values[value]
    return w


def both(graph: Any, x: Any, dot: Any, bar: Any) -> tuple[Any, Any]:
    """Derivative of a function (n,) -> (m,) along `dot`, and the cotangent of x for `bar`."""
    n, m = len(x), len(bar)
    function, mirror = traced("f", graph, [0], n), n + m
    w = np.concatenate([x, np.zeros(m), dot, np.zeros(m)])
    forward = run(tangent(function, mirror), w)[mirror + n :]
    w[mirror:] = np.concatenate([np.zeros(n), bar])
    back = run(adjoint(function, mirror), w)[mirror:]
    assert not back[n:].any()  # what was overwritten has no cotangent before
    return forward, back[:n]


@pytest.mark.parametrize("name", ["slim", "two-link"])
@pytest.mark.parametrize("implicit", [False, True])
def test_accelerations_have_the_derivatives_that_casadi_finds(name: str, implicit: bool) -> None:
    """CasADi differentiates true sines and cosines; the trace has polynomials in their place."""
    graph = graphs.accelerations(TracedArm(ARMS[name]), implicit)
    parts = graph.sx_in()
    x = ca.SX.sym("x", sum(part.numel() for part in parts))
    split = ca.vertsplit(x, np.cumsum([0, *(part.numel() for part in parts)]).tolist())
    whole = ca.Function("f", [x], [graph(*split)])
    rng = np.random.default_rng(0)
    at, dot = 0.3 * rng.normal(size=(2, x.numel()))
    bar = rng.normal(size=whole.numel_out())
    exact = np.array(ca.Function("J", [x], [ca.jacobian(whole(x), x)])(at))
    forward, back = both(whole, at, dot, bar)
    np.testing.assert_allclose(forward, exact @ dot, rtol=1e-10)
    np.testing.assert_allclose(back, bar @ exact, rtol=1e-10, atol=1e-10 * abs(bar @ exact).max())


@pytest.mark.parametrize(
    ("function", "at", "slopes"),
    [
        (lambda a, b: ca.fmin(a, b), (1.0, 2.0), (1.0, 0.0)),
        (lambda a, b: ca.fmin(a, b), (1.0, 1.0), (1.0, 0.0)),
        (lambda a, b: ca.fmax(a, b), (1.0, 2.0), (0.0, 1.0)),
        (lambda a, b: ca.fmax(a, b), (1.0, 1.0), (1.0, 0.0)),
        (lambda a, b: ca.fabs(a) + b, (0.0, 1.0), (0.0, 1.0)),
        (lambda a, b: ca.fabs(a) + b, (-2.0, 1.0), (-1.0, 1.0)),
        (lambda a, b: ca.sqrt(a) + b, (0.0, 1.0), (0.0, 1.0)),
        (lambda a, b: ca.sqrt(a) + b, (0.25, 1.0), (1.0, 1.0)),
        (lambda a, b: ca.floor(a / 0.1 + 0.5) * 0.1 * b, (0.32, 2.0), (2.0, 0.3)),
        (lambda a, b: (a < b) * b, (1.0, 2.0), (0.0, 1.0)),
        (lambda a, b: a / b, (3.0, 2.0), (0.5, -0.75)),
        (lambda a, b: ca.tanh(a) - ca.sin(b), (0.0, 0.0), (1.0, -1.0)),
    ],
)  # fmt: skip
def test_rules_where_a_derivative_jumps(
    function: Callable[..., Any], at: tuple[float, float], slopes: tuple[float, float]
) -> None:
    """As the module states them."""
    x = ca.SX.sym("x", 2)
    graph = ca.Function("f", [x], [function(x[0], x[1])])
    forward, back = both(graph, np.array(at), np.array([1.0, 0.0]), np.array([1.0]))
    np.testing.assert_allclose(back, slopes, rtol=1e-12)
    np.testing.assert_allclose(forward, slopes[0], rtol=1e-12)


def test_what_is_read_and_overwritten_keeps_one_cotangent() -> None:
    """x := x^2 turns the cotangent of the new x into that of the old one."""
    x = ca.SX.sym("x")
    function = traced("f", ca.Function("f", [x], [x * x]), [0], 0)
    assert run(adjoint(function, 1), np.array([3.0, 5.0])).tolist() == [3.0, 30.0]
    assert run(tangent(function, 1), np.array([3.0, 5.0])).tolist() == [9.0, 30.0]


def test_passive_slots_have_no_derivatives() -> None:
    """Neither is read nor written."""
    x = ca.SX.sym("x", 2)
    function = traced("f", ca.Function("f", [x], [x[0] * x[1]]), [0], 2)
    back = run(adjoint(function, 3, passive=[1]), np.array([3.0, 5.0, 0.0, 0.0, 7.0, 1.0]))
    assert back[3:].tolist() == [5.0, 7.0, 0.0]
