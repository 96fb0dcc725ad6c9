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
from flexarm_env.task.events import EVENTS, PAYLOAD, TIME
from flexarm_env.task.scales import EXTENT, home_posture


class Happening:
    """The event of an environment.

    Parameters
    ----------
    name : of an event in `task.events.EVENTS`.
    axes : axes of the tip along which a push acts.
    n_joint : joints whose targets jump.

    Attributes
    ----------
    drawn : rows of the state that are drawn at a reset, with their sizes.
    changing : whether `event(w)` changes a rate or a parameter of the arm.
    """

    def __init__(self, name: str, axes: tuple[int, ...], n_joint: int) -> None:
        self.name, self._axes = name, axes
        self._n = {"drop": 0, "jump": n_joint, "push": len(axes)}[name]
        self.drawn = {"event_time": 1, "event_size": self._n, "event_sign": self._n}
        self.changing = name != "jump"

    @property
    def key(self) -> str:
        """Cache key: the properties on which the compiled functions depend."""
        return f"event {self.name} {self._axes}"

    def ranges(self, move: float, impulse: float) -> Array:
        """(n_drawn, 2) ranges of the drawn rows.

        `move` [control steps] is the move time, `impulse` [N s] the scale of a push.
        """
        unit = impulse if self.name == "push" else 1.0
        size = np.array(EVENTS[self.name].size) * unit
        return np.array([np.array(TIME) * move, *self._n * [size], *self._n * [(-1.0, 1.0)]])

    def happened(self, s: Symbols) -> Any:
        """Whether the event has happened."""
        return s["event_time"] < s["elapsed"]

    def centre(self, s: Symbols) -> Any:
        """Joint angles [rad] of the target, or the centre of its path, after a jump."""
        import casadi as ca

        if self.name != "jump":
            return s["centre"]
        jump = _signed(s["event_size"], s["event_sign"])
        off = s["centre"] - ca.DM(home_posture(self._n))
        inside = 1.0 - 2.0 * (ca.fabs(off + jump) > EXTENT)
        return s["centre"] + self.happened(s) * inside * jump

    def functions(self, model: Model, at: Mapping[str, int], first: int) -> list[Function]:
        """`event(w)` of an event that changes the arm; `first` is the slot of its drawn rows."""
        if self.name == "drop":
            slot = at["PARAMETERS"] + model.free_parameters.index(PAYLOAD)
            return [traced("event", self._drop(), [first, at["ELAPSED"], slot], slot)]
        if self.name == "push":
            inputs = [first, *(at[name] for name in ("ELAPSED", "Q", "V", "PARAMETERS"))]
            return [traced("event", self._push(model), inputs, at["V"])]
        return []

    def _drop(self) -> Any:
        """CasADi Function (time, elapsed, payload) -> payload."""
        import casadi as ca

        time, elapsed, carried = map(ca.SX.sym, ("event_time", "elapsed", "payload"))
        return ca.Function("drop", [time, elapsed, carried], [carried * (elapsed <= time)])

    def _push(self, model: Model) -> Any:
        """CasADi Function (drawn, elapsed, q, v, parameters) -> rates after a push."""
        import casadi as ca

        sizes = {"drawn": 1 + 2 * self._n, "elapsed": 1, "q": model.n, "v": model.n,
                 "parameters": len(model.free_parameters)}  # fmt: skip
        symbols = drawn, elapsed, q, v, parameters = [ca.SX.sym(*x) for x in sizes.items()]
        time, size, sign = ca.vertsplit(drawn, [0, 1, 1 + self._n, 1 + 2 * self._n])
        impulse = ca.SX(3, 1)
        impulse[list(self._axes)] = _signed(size, sign)
        change = graphs.pushed(model.traced)(q, parameters, impulse)
        now = (time < elapsed) * (elapsed - 1.0 <= time)
        return ca.Function("push", symbols, [ca.cse(v + now * change)])


def _signed(size: Any, sign: Any) -> Any:
    """Sizes with the signs of other numbers."""
    return size * (1.0 - 2.0 * (sign < 0.0))
