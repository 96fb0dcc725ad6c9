"""Ends of episodes: termination, truncation and the flags beside them; the cost of curvature."""

from collections.abc import Iterable
from functools import reduce
from typing import Any

from dynamics.simulation.validity import FARTHEST
from dynamics.tracing.function import Function, written
from dynamics.tracing.ssa import Code
from dynamics.types import Symbols

FLAGS = ("terminated", "truncated", "settled", "diverged", "invalid", "overspeed")
FARTHEST_SINGLE = 1e5  # [rad], [rad/s] largest state in float32, as FARTHEST in float64
LOST = 3.0  # [-] times the deflection limit: beyond, the model of the arm is meaningless


def flags(
    s: Symbols, live: Any, settled: Any, deflection: Any, slope: Any, joint_rates: Any
) -> dict[str, Any]:
    """Flags by name, 1 or 0, of symbols.

    Parameters
    ----------
    s : constants of the environment, and `elapsed` and `lost`.
    live : 0 at the start of an episode, which ends nothing.
    settled : whether the tip is on its target.
    deflection, slope : [-] and [rad] largest of all links.
    joint_rates : (n_joint,) [rad/s].
    """
    import casadi as ca

    invalid = ca.fmax(s["deflection_limit"] < deflection, s["slope_limit"] < slope)
    diverged = ca.fmax(s["lost"], LOST * s["deflection_limit"] < deflection)
    return {
        "terminated": live * ca.fmax(invalid, diverged),
        "truncated": live * (s["max_steps"] > 0.0) * (s["max_steps"] <= s["elapsed"]),
        "settled": settled,
        "diverged": diverged,
        "invalid": invalid,
        "overspeed": s["rate_limit"] ** 2 < reduce(ca.fmax, ca.vertsplit(joint_rates**2)),
    }


def cost(s: Symbols, curvature: Any) -> Any:
    """Excess [-] of the gauges' curvatures [1/m] over their limits: the largest, 0 within."""
    import casadi as ca

    excess = ca.fabs(curvature) / s["curvature_limit"] - 1.0
    return (s["elapsed"] > 0.0) * reduce(ca.fmax, ca.vertsplit(excess), ca.SX(0.0))


def lost(state: Iterable[int], numbers: Iterable[int], result: int, dtype: str) -> Function:
    """`check(w)`: set a slot to 1 if the state is too large or a reported number is not finite.

    `state` and `numbers` are slots of the state and of the reported numbers.
    """
    code = Code()
    squares = reported = code.constant(0.0)
    for slot in state:
        x = code.load(slot)
        squares = code.emit("+", squares, code.emit("*", x, x))
    for slot in numbers:
        reported = code.emit("+", reported, code.load(slot))
    farthest = FARTHEST if dtype == "float64" else FARTHEST_SINGLE
    near = code.emit("at_most", squares, code.constant(farthest**2))
    zero = code.emit("abs", code.emit("-", reported, reported))
    finite = code.emit("at_most", zero, code.constant(0.0))
    failed = code.emit("-", code.constant(1.0), code.emit("*", near, finite))
    return written("check", code, {result: failed})
