"""Start of an episode within the control step, for backends that restart ended episodes there.

It draws what `episode.begin` draws, in the same order from the same streams, but as a traced
function of uniform random numbers: `begin(w)`. Ranges of free parameters are slots, because they
may change.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dynamics.tracing.assembly import Addition
from dynamics.tracing.function import Function, traced
from dynamics.tracing.statements import (
    Call,
    ControlStep,
    Load,
    Statement,
    Store,
    Uniform,
    WhereEnded,
)
from flexarm_env.compiled.episode import MOVES, SHAKE, SHARE, START, STRAIGHT, TEMPO, WAVES
from flexarm_env.compiled.signals import Signals


def restarting(signals: Signals, start: tuple[Any, ...]) -> Addition:
    """The addition of an environment whose step starts new episodes where one has ended.

    The step stores the last observation of an episode in the array "final_obs".
    `start` are the arguments of `episode.begin` between `rows` and `state`.
    """
    addition = signals.addition
    entry = addition.entry
    assert isinstance(entry, ControlStep)
    drawn = len(start[7])  # ranges of the free parameters, and of what the hardware draws
    graph, count = first_state(signals, start)
    functions = addition.functions

    def with_begin(at: Mapping[str, int]) -> list[Function]:
        inputs = [at["UNIFORM"], at["RANGES"]]
        slots = _slots(at, entry)
        return [*functions(at), traced("begin", graph, inputs, slots)]

    observation = entry.rows["OBSERVATION"]
    last = Store("OBSERVATION", replace(observation, name="FINAL_OBSERVATION", array="final_obs"))
    restart = WhereEnded("FLAGS", (Uniform("UNIFORM", count), *_restart(entry)))
    return replace(
        addition,
        key=f"{addition.key} restarting",
        sizes={**addition.sizes, "UNIFORM": count, "RANGES": 2 * drawn},
        functions=with_begin,
        shared=(*addition.shared, "RANGES"),
        entry=replace(entry, step=(*entry.step, last, restart)),
    )


def _restart(entry: ControlStep) -> Iterator[Statement]:
    """Begin, store the whole state, then report it as at a start; flags and info stay."""
    yield Call("begin")
    yield from (Store(load.slots, load.rows) for load in _loads(entry))
    for statement in entry.start:
        shown = isinstance(statement, Store) and statement.rows.array in ("flags", "info")
        if not isinstance(statement, Load) and not shown:
            yield statement


def _slots(at: Mapping[str, int], entry: ControlStep) -> list[int]:
    """Slot of every row of the state."""
    return [at[load.slots] + k for load in _loads(entry) for k in range(load.rows.count)]


def _loads(entry: ControlStep) -> list[Load]:
    """Loads of the step, which reads the whole state in the order of its rows."""
    return [x for x in entry.step if isinstance(x, Load) and x.rows.array == "state"]


def first_state(signals: Signals, start: tuple[Any, ...]) -> tuple[Any, int]:
    """CasADi Function (uniform, ranges) -> rows of the state, and how many numbers it draws."""
    import casadi as ca

    ranges, home, joints, base, amplitude, rate, most, free, _ = start
    count = _draws(ranges, len(home), len(base), len(amplitude)) + len(free)
    uniform, limits = ca.SX.sym("uniform", count), ca.SX.sym("ranges", 2 * len(free))
    numbers = iter(ca.vertsplit(uniform))
    state = {name: ca.SX(size, 1) for name, size in signals.state.sizes.items()}

    def draw(limits: Any) -> Any:
        return limits[0] + (limits[1] - limits[0]) * next(numbers)

    for k, limit in enumerate(base):
        state["q"][k] = draw(limit)
    for j, coordinate in enumerate(joints.tolist()):
        centre = home[j] + draw(ranges[START])
        state["q"][coordinate] = centre
        if ranges[MOVES, 1] > 0.0:
            sign = 1.0 - 2.0 * (next(numbers) >= 0.5)
            centre += sign * draw(ranges[MOVES])
        if ranges[TEMPO, 1] > 0.0:
            for k in range(WAVES):
                tempo, share = draw(ranges[TEMPO]), draw(ranges[SHARE])
                wave = k * len(home) + j
                state["amplitude"][wave] = ca.fmin(share * most[1] / (tempo * tempo), most[0])
                state["frequency"][wave] = tempo
                state["phase"][wave] = draw((0.0, 2.0 * np.pi))
        state["centre"][j] = centre
    if ranges[SHAKE, 1] > 0.0:
        modal = [i for i in range(state["q"].numel()) if i not in joints.tolist()]
        for bent, moved in zip(amplitude, rate, strict=True):
            here, moving = draw(ranges[SHAKE]), draw(ranges[SHAKE])
            for k, i in enumerate(modal):
                state["q"][i] += bent[k] * here
                state["v"][i] += moved[k] * moving
    if signals.bent:
        state["elapsed"] = ca.SX(STRAIGHT)
    drawn = [draw((limits[2 * k], limits[2 * k + 1])) for k in range(len(free))]
    return _stacked(signals, state, drawn, [uniform, limits]), count


def _stacked(signals: Signals, state: dict[str, Any], drawn: list[Any], inputs: list[Any]) -> Any:
    """The Function of all rows, with actuators at rest."""
    import casadi as ca

    if signals.actuation:
        state["actuator"] = signals.actuation.rest(state["q"])
    names = [name for name in state if name != "free" and name not in signals.drawn]
    rows = ca.vertcat(*(state[name] for name in names), *drawn)
    return ca.Function("begin", inputs, [ca.cse(ca.densify(rows))])


def _draws(ranges: Any, joints: int, base: int, modes: int) -> int:
    """Random numbers that a start draws besides those of free parameters."""
    each = 1 + 2 * (ranges[MOVES, 1] > 0.0) + 3 * WAVES * (ranges[TEMPO, 1] > 0.0)
    return int(base + joints * each + 2 * modes * (ranges[SHAKE, 1] > 0.0))
