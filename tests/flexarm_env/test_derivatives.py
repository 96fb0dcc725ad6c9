"""Derivatives of control steps, held against differences of the steps themselves."""

from typing import Any

import numpy as np
import pytest

from dynamics.runtime.jit import aligned_zeros
from flexarm_env.core import Core
from flexarm_env.derivatives import Along, Derivatives, Recorded
from flexarm_env.task.tasks import TASKS

N = 5
FINE = {"gauge_noise": 0.01, "gauge_bias": 0.01, "accelerometer_noise": 0.01, "delay": (0, 2)}
SERVO: dict[str, Any] = {
    "actuator": "quanser-servo", "hardware": FINE, "randomize": {"payload_mass": (0.0, 0.1)}
}  # fmt: skip
CASES: dict[str, dict[str, Any]] = {
    "two-link-Track-servo": {"arm": "two-link", "task": "Track", **SERVO},
    **{f"slim-{task}": {"arm": "slim", "task": task} for task in TASKS},
    "slim-randomized": {"arm": "slim", "task": "Reach", "randomize": {"stiffness": (0.8, 1.2)}},
    "slim-sensors": {"arm": "slim", "task": "Damp", "hardware": FINE},
    "slim-push": {"arm": "slim", "task": "Reach", "event": "push"},
    "slim-drop": {"arm": "slim", "task": "Track", "event": "drop", "curvature_limit": 0.01},
    "two-link-jump": {"arm": "two-link", "task": "Reach", "event": "jump"},
    "two-link-Reach": {"arm": "two-link", "task": "Reach"},
    "two-link-Damp": {"arm": "two-link", "task": "Damp"},
    "two-link-hydraulic": {"arm": "two-link", "task": "Reach", "actuator": "ralf-1"},
    "free-flyer-Reach": {"arm": "free-flyer", "task": "Reach"},
    "six-link-Reach": {"arm": "six-link", "task": "Reach"},
    **{
        f"slim-{name}": {"arm": "slim", "task": "Reach", "integrator": name, "substeps": 3}
        for name in ("rk4", "midpoint", "generalized-alpha", "exponential-2")
    },
}  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def moving(request: pytest.FixtureRequest) -> Core:
    """Environments in motion; their sensors read without counts."""
    core = Core(n_env=N, control_dt=0.02, **CASES[request.param])
    core.constants = core.constants.copy()
    for name in ("encoder_step", "gauge_step"):
        if name in core.signals.constants.slices:
            core.constants[core.signals.constants.slices[name]] = 1e-12
    for w in core.workspaces:
        core.fill_constants(w, core.program)
    for row in range(N):
        core.seed(row, np.random.default_rng(row))
    core.reset(np.arange(N))
    if core.happening:
        core.state[core.signals.state.slices["event_time"], :N] = 6.0
    rng = np.random.default_rng(0)
    for _ in range(6):
        core.step(rng.uniform(-0.6, 0.6, (N, core.arm.n_torque)).astype(np.float32))
    return core


def aligned(values: Any) -> Any:
    result = aligned_zeros(values.shape, values.dtype)
    result[...] = values
    return result


def direction(core: Core) -> tuple[Any, Any]:
    """Small, along all rows of the state that are not counters or draws, and along actions."""
    rng, at = np.random.default_rng(1), core.signals.state.slices
    along = 1e-2 * rng.normal(size=core.state.shape)
    for name in ("elapsed", *core.signals.drawn):
        along[at[name]] = 0.0
    for name in ("q", "v", "centre", "target"):
        along[at[name]] *= 0.1
    return aligned(along), 0.1 * rng.normal(size=(N, core.arm.n_torque))


def results(step: Recorded | Along) -> Any:
    """All numbers that a step gives, a row per environment."""
    return np.concatenate([step.after[:, :N].T, step.obs, step.info[:, :N].T], axis=1)


def test_derivatives_are_those_of_the_step(moving: Core) -> None:
    """Along a direction by extrapolated differences; back by what forward gives."""
    core, derivatives = moving, Derivatives(moving)
    state = aligned(core.state)
    actions = np.random.default_rng(2).uniform(-0.6, 0.6, (N, core.arm.n_torque))
    along, by = direction(core)

    def difference(h: float) -> Any:
        ahead, behind = (
            results(derivatives.record(aligned(state + s * along), actions + s * by))
            for s in (h, -h)
        )
        return (ahead - behind) / (2.0 * h)

    forward = derivatives.push_forward(state, actions, along, by)
    exact = (4.0 * difference(1e-3) - difference(2e-3)) / 3.0
    np.testing.assert_allclose(results(forward), exact, atol=1e-7 * abs(exact).max(), rtol=1e-7)

    step = derivatives.record(state, actions)
    rng = np.random.default_rng(3)
    bars = [aligned(rng.normal(size=x.shape)) for x in (step.after, step.obs, step.info)]
    before, back = derivatives.pull_back(state, actions, step.stack, *bars)
    moved = [x * y for x, y in zip((forward.after, forward.obs, forward.info), bars, strict=True)]
    gained = moved[0][:, :N].sum(0) + moved[1].sum(1) + moved[2][:, :N].sum(0)
    given = (before * along)[:, :N].sum(0) + (back * by).sum(1)
    np.testing.assert_allclose(given, gained, rtol=1e-11, atol=1e-11 * abs(gained).max())


def test_a_recorded_step_is_the_step(moving: Core) -> None:
    """State, observation, info and flags; blocks of other sizes round differently."""
    actions = np.random.default_rng(4).uniform(-1.0, 1.0, (N, moving.arm.n_torque))
    before, given = aligned(moving.state), actions.astype(np.float32)
    step = Derivatives(moving).record(before, given)
    out, _ = moving.step(given)
    np.testing.assert_array_equal(out.flags[:, :N], step.flags[:, :N])
    for plain, recorded in ((moving.state, step.after), (out.info, step.info)):
        np.testing.assert_allclose(plain[:, :N], recorded[:, :N], rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(out.obs, step.obs, rtol=1e-6, atol=1e-6)


def test_methods_that_numba_compiles_whole_are_refused() -> None:
    """With the remedy."""
    core = Core(task="Reach", arm="slim", n_env=2, integrator="rosenbrock")
    with pytest.raises(ValueError, match=r"integrator 'rosenbrock' has no derivatives.*numerov"):
        Derivatives(core)


def test_arrays_of_other_shapes_are_refused() -> None:
    """A state without the padding gave another motion, from memory past its end."""
    core = Core(n_env=N, control_dt=0.02, arm="slim", task="Reach")
    derivatives, state, actions = Derivatives(core), core.state, np.zeros((N, 1), np.float32)
    with pytest.raises(
        ValueError, match=r"state must have shape .*padded as core.state, got \(.*5\)"
    ):
        derivatives.record(state[:, :N], actions)
    with pytest.raises(ValueError, match=r"actions must have shape \(5, 1\), got \(4, 1\)"):
        derivatives.record(state, actions[1:])
    with pytest.raises(ValueError, match="along must have shape"):
        derivatives.push_forward(state, actions, state[:, :N], actions)
    step = derivatives.record(state, actions)
    given = {name: getattr(step, name) for name in ("stack", "after", "obs", "info")}
    for name, array in given.items():
        with pytest.raises(ValueError, match=rf"{name} must have shape .*, got \("):
            derivatives.pull_back(state, actions, **given | {name: array[1:]})


def test_numbers_that_are_not_real_are_refused_and_lists_taken() -> None:
    """They ended in tracebacks of the compiler."""
    core = Core(n_env=N, control_dt=0.02, arm="slim", task="Reach")
    derivatives, state, actions = Derivatives(core), core.state, np.full((N, 1), 0.25)
    for wrong in (complex, object, str):
        with pytest.raises(ValueError, match="actions must hold real numbers, got dtype"):
            derivatives.record(state, actions.astype(wrong))
    expected = results(derivatives.record(state, actions))
    for same in (actions.tolist(), actions.astype(np.longdouble)):
        np.testing.assert_array_equal(results(derivatives.record(state, same)), expected)


def test_views_and_whole_numbers_have_the_derivatives_of_their_copies() -> None:
    """Actions of one time out of (N, T, m), and arrays by columns, gave other motions."""
    core = Core(n_env=N, control_dt=0.02, arm="slim", task="Reach")
    derivatives, rng = Derivatives(core), np.random.default_rng(5)
    state = 0.01 * rng.normal(size=core.state.shape)
    several = rng.integers(-1, 2, (N, 3, 1))
    views = [np.asfortranarray(state), several[:, 1], np.asfortranarray(state), several[:, 2]]
    copies = [aligned(x.astype(float)) for x in views]
    found, expected = (derivatives.push_forward(*x) for x in (views, copies))
    np.testing.assert_array_equal(results(found), results(expected))
    step, same = (derivatives.record(*x[:2]) for x in (views, copies))
    np.testing.assert_array_equal(results(step), results(same))
    given = (step.stack, step.after, step.obs, step.info)
    backs = [
        derivatives.pull_back(*x[:2], *map(order, given))
        for x, order in ((views, np.asfortranarray), (copies, np.ascontiguousarray))
    ]
    for back, exact in zip(*backs, strict=True):
        np.testing.assert_array_equal(back, exact)
