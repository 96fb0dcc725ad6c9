"""The control step as a program: everything it names exists, and nothing is left out."""

from typing import Any

import casadi as ca
import gymnasium as gym
import numpy as np
import pytest

import flexarm_env  # noqa: F401
from dynamics.tracing.assembly import Program, assembled
from dynamics.tracing.statements import Call, ControlStep, Copy, Load, Store, walked
from flexarm_env.compiled.restart import first_state

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "plain": ("OneLink-Reach", {}),
    "laboratory": ("OneLink-Reach", {"hardware": "laboratory"}),
    "actuators": ("OneLink-Track", {"actuator": "quanser-servo"}),
    "push": ("OneLink-ReachPush", {}),
    "free base": ("FreeFlyer-Reach", {"randomize": {"payload_mass": (0.0, 0.1)}, "event": "drop"}),
}


@pytest.fixture(scope="module", params=CASES)
def batch(request: pytest.FixtureRequest) -> tuple[Any, Program]:
    """An environment's core, and its program."""
    name, keywords = CASES[request.param]
    core: Any = gym.make(f"FlexArm/{name}-v0", **keywords).unwrapped.core  # type: ignore[attr-defined]
    added = core.signals.addition
    return core, assembled(core.model.traced, "float64", 1, core.integrator, added)


def test_every_called_function_and_slot_exists(batch: tuple[Any, Program]) -> None:
    _, program = batch
    known = {function.name for function in program.functions} | set(program.routines)
    assert isinstance(program.entry, ControlStep)
    inside = [x for routine in program.routines.values() for x in walked(routine)]
    for statement in (*program.entry.statements, *inside):
        match statement:
            case Call(name):
                assert name in known
            case Load(slots, rows) | Store(slots, rows) | Copy(_, slots, rows):
                assert program.at[slots] + rows.count <= program.slots
                assert rows.count > 0


def test_every_function_is_called(batch: tuple[Any, Program]) -> None:
    _, program = batch
    assert isinstance(program.entry, ControlStep)
    inside = [x for routine in program.routines.values() for x in walked(routine)]
    called = {x.name for x in (*program.entry.statements, *inside) if isinstance(x, Call)}
    assert {function.name for function in program.functions} <= called


def test_a_step_reads_and_keeps_the_whole_state(batch: tuple[Any, Program]) -> None:
    """Only the reference, the free base's anchor and what an episode draws are not written back."""
    core, program = batch
    assert isinstance(program.entry, ControlStep)
    step = [x for x in program.entry.step if getattr(x, "rows", None)]
    read = {
        i
        for x in step
        if isinstance(x, Load) and x.rows.array == "state"
        for i in range(x.rows.first, x.rows.first + x.rows.count)
    }
    kept = {
        i
        for x in step
        if isinstance(x, Store) and x.rows.array == "state"
        for i in range(x.rows.first, x.rows.first + x.rows.count)
    }
    assert read == set(range(core.signals.state.total))
    assert kept == set(range(core.signals.state.slices["centre"].start))


def test_a_restart_draws_every_parameter_from_its_own_range(batch: tuple[Any, Program]) -> None:
    """With the last of the random numbers, as `episode.begin` does."""
    core, _ = batch
    free = core.starts[7]
    graph, count = first_state(core.signals, core.starts)
    numbers = np.random.default_rng(0).uniform(size=count)
    state = graph(numbers, free.ravel()).full().ravel()
    share = numbers[count - len(free) :]
    drawn = state[core.signals.state.slices["free"].start :]
    np.testing.assert_allclose(drawn, (1.0 - share) * free[:, 0] + share * free[:, 1], rtol=1e-12)


def test_the_rate_of_a_path_is_the_derivative_of_its_angle() -> None:
    """At the start, on the ramp, and behind it; by differentiation of the graph."""
    core: Any = gym.make("FlexArm/TwoLink-Track-v0").unwrapped.core  # type: ignore[attr-defined]
    numbers, t = np.random.default_rng(0), ca.SX.sym("t")
    sizes = {name: rows.stop - rows.start for name, rows in core.signals.state.slices.items()}
    names = ("centre", "amplitude", "frequency", "phase")
    s = {name: ca.DM(numbers.uniform(0.5, 2.0, sizes[name])) for name in names}
    target, rate = core.signals._reference(s | {"move_time": 0.7}, t)
    error = ca.Function("error", [t], [ca.jacobian(target, t) - rate, rate])
    for time in (0.0, 0.3, 0.6, 1.9):
        apart, moving = error(time)
        np.testing.assert_allclose(apart, 0.0, atol=1e-12)
        assert (np.abs(moving.full()).min() > 1e-3) == (time > 0.0)
