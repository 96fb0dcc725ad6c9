"""Events inside the compiled control step; `task.events` describes them.

An event of time t [control steps] happens at the start of step floor(t), counted from 0: at the end
of that step, `elapsed` is above t for the first time.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dynamics.model import Model
from dynamics.tracing import graphs
from dynamics.tracing.function import Function, traced
from dynamics.types import Array, Symbols
from flexarm_env.task.events import EVENTS, PAYLOAD, PUSHED, TIME
from flexarm_env.task.scales import EXTENT, home_posture

CARRIED = "CARRIED"  # slots of the drawn parameters, where a payload is dropped


class Happening:
    """The event of an environment.

    Parameters
    ----------
    name : of an event in `task.events.EVENTS`.
    axes : axes of the tip along which a push acts.
    n_joint : joints whose targets jump.
    move : [control steps] move time.

    Attributes
    ----------
    drawn : rows of the state that are drawn at a reset, with their sizes.
    """

    def __init__(self, name: str, axes: tuple[int, ...], n_joint: int, move: float) -> None:
        self.name, self._axes, self._move = name, axes, move
        self._pulse = max(1, round(PUSHED * move))  # [control steps]
        self._n = {"drop": 0, "jump": n_joint, "push": len(axes)}[name]
        self.drawn = {"event_time": 1, "event_size": self._n, "event_sign": self._n}

    @property
    def key(self) -> str:
        """Cache key: the properties on which the compiled functions depend."""
        return f"event {self.name} {self._axes} {self._pulse}"

    def ranges(self, force: float) -> Array:
        """(n_drawn, 2) ranges of the drawn rows: [control steps], [rad] or [N], [-].

        `force` [N] has the scale of a push as its impulse within a control step.
        """
        unit = force / self._pulse if self.name == "push" else 1.0
        size = np.array(EVENTS[self.name].size) * unit
        return np.array([np.array(TIME) * self._move, *self._n * [size], *self._n * [(-1.0, 1.0)]])

    def happened(self, s: Symbols) -> Any:
        """1 once the event has happened, else 0."""
        return s["event_time"] < s["elapsed"]

    def centre(self, s: Symbols) -> Any:
        """Joint angles [rad] of the target, or the centre of its path, after a jump."""
        import casadi as ca

        if self.name != "jump":
            return s["centre"]
        jump = _signed(s["event_size"], s["event_sign"])
        off = s["centre"] - ca.DM(home_posture(self._n))
        farthest = ca.fmax(EXTENT, ca.fabs(off))  # a target of the user's own may be beyond
        inside = 1.0 - 2.0 * (ca.fabs(off + jump) > farthest)
        return s["centre"] + self.happened(s) * inside * jump

    def slots(self, model: Model) -> dict[str, int]:
        """Further slots of the workspace, with their sizes."""
        return {CARRIED: len(model.free_parameters)} if self.name == "drop" else {}

    def functions(self, model: Model, at: Mapping[str, int], first: int) -> list[Function]:
        """`drop(w)` or `push(w)`; `first` is the slot of the drawn rows."""
        if self.name == "drop":
            inputs = [first, at["ELAPSED"], at[CARRIED]]
            return [traced("drop", self._drop(model), inputs, at["PARAMETERS"])]
        if self.name == "push":
            names = ("ELAPSED", "Q", "V", "TAU", "PARAMETERS", "IMPLICIT", "ACC")
            graph = self._push(model, implicit=at["ACC"] > at["IMPLICIT"])
            return [traced("push", graph, [first, *(at[name] for name in names)], at["ACC"])]
        return []

    def _drop(self, model: Model) -> Any:
        """CasADi Function (time, elapsed, drawn parameters) -> parameters."""
        import casadi as ca

        time, elapsed = ca.SX.sym("event_time"), ca.SX.sym("elapsed")
        drawn = ca.SX.sym("drawn", len(model.free_parameters))
        present = ca.SX(drawn)
        present[model.free_parameters.index(PAYLOAD)] *= elapsed <= time
        return ca.Function("drop", [time, elapsed, drawn], [present])

    def _push(self, model: Model, implicit: bool) -> Any:
        """CasADi Function (drawn, elapsed, inputs of `accelerations`, a) -> a with the push."""
        import casadi as ca

        pushed = graphs.pushed(model.traced, implicit)
        *inputs, _ = pushed.sx_in()
        drawn, elapsed = ca.SX.sym("drawn", 1 + 2 * self._n), ca.SX.sym("elapsed")
        a = ca.SX.sym("a", model.n)
        time, size, sign = ca.vertsplit(drawn, [0, 1, 1 + self._n, 1 + 2 * self._n])
        force = ca.SX(3, 1)
        force[list(self._axes)] = _signed(size, sign)
        now = (time < elapsed) * (elapsed - self._pulse <= time)
        result = a + now * pushed(*inputs, force)
        return ca.Function("push", [drawn, elapsed, *inputs, a], [ca.cse(result)])


def _signed(size: Any, sign: Any) -> Any:
    """Sizes with the signs of other numbers."""
    return size * (1.0 - 2.0 * (sign < 0.0))
