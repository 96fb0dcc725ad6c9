"""Events in mid-episode against computations of their own: SciPy, finite differences, balances."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynamics.arms import ARMS
from dynamics.description.parameters import with_parameters
from dynamics.model import Model
from flexarm_env.core import Core
from flexarm_env.task.events import EVENTS, PUSHED, TIME
from flexarm_env.task.scales import EXTENT

STEPS, AT = 20, 7  # steps of a test, of which the eighth has the event
NEVER = 1e6


def placed(core: Core, name: str, values: Any) -> None:
    """Set rows of the state."""
    core.state[core.signals.state.slices[name], : core.n_env] = values


def started(event: str, n_env: int = 2, **keywords: Any) -> Core:
    """Environments that begin alike; the first has its event in step AT, the others never."""
    core = Core(task="Reach", arm="slim", n_env=n_env, event=event, **keywords)
    core.seed(0, np.random.default_rng(1))
    core.reset(np.arange(1))
    core.state[:] = core.state[:, :1]
    placed(core, "event_time", NEVER)
    core.state[core.signals.state.slices["event_time"], 0] = AT + 0.3
    return core


def turned(core: Core, k: int, size: float = 0.5) -> Any:
    """Outputs of step k under the same torque for all."""
    action = np.full((core.n_env, core.arm.n_torque), size * np.sin(0.9 * k), np.float32)
    return core.step(action)[0]


def jacobian(model: Model, q: Any, h: float = 1e-5) -> Any:
    """(2, n) of the tip in the plane, by differences of fourth order."""

    def difference(x: float) -> Any:
        moves = x * np.eye(q.size)
        return np.array([model.tip(q + e) - model.tip(q - e) for e in moves]).T[:2] / (2.0 * x)

    return (4.0 * difference(h) - difference(2.0 * h)) / 3.0


def across(model: Model, q: Any) -> Any:
    """(2,) unit vector across a single bent link at its tip."""
    c, s = np.cos(q[0]), np.sin(q[0])
    bent = np.sign(c * model.tip(q)[1] - s * model.tip(q)[0])
    angle = q[0] + bent * model._measure(q, 0.0 * q)[model.measurements["slope"]].item()
    return np.array([-np.sin(angle), np.cos(angle)])


def check_by_scipy(core: Core, rates: Any) -> None:
    """Compare the motion with that of `rates` (step, q, v, torque) -> accelerations."""
    x = np.concatenate([core.q[0], core.v[0]])
    for k in range(STEPS):
        torque = core.torque_limit * np.float32(0.5 * np.sin(0.9 * k))

        def slope(_: float, x: Any, k: int = k, torque: Any = torque) -> Any:
            return np.concatenate([x[3:], rates(k, x[:3], x[3:], torque)])

        x = solve_ivp(slope, (0.0, 0.02), x, method="DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
        info = turned(core, k).described()
        assert info["event"][0] == (k >= AT)
        np.testing.assert_allclose(core.q[0], x[:3], rtol=1e-5, atol=1e-7)


def test_a_push_is_a_force_across_the_bent_tip() -> None:
    """By SciPy, with M a = B tau - h + J' F; its impulse is in the stated range."""
    core, model = started("push", n_env=1, substeps=40), Model(ARMS["slim"])
    rows, dt = core.signals.state.slices, core.control_dt
    force = core.state[rows["event_size"], 0] * np.sign(core.state[rows["event_sign"], 0])
    pulse = round(PUSHED * core.move_time / dt)
    scale = core.scales.inertia[0] * core.rate_scale / core.arm.reach
    low, high = EVENTS["push"].size
    assert low <= abs(force.item()) * pulse * dt / scale <= high

    def rates(k: int, q: Any, v: Any, torque: Any) -> Any:
        a = model.accelerations(q, v, torque)
        if not AT <= k < AT + pulse:
            return a
        return a + np.linalg.solve(
            model.mass_matrix(q), jacobian(model, q).T @ (force * across(model, q))
        )

    check_by_scipy(core, rates)


def test_a_dropped_payload_is_gone_and_moves_nothing() -> None:
    """By SciPy: the arm with the payload until the event, without it from there on."""
    core = started("drop", n_env=1, substeps=40)
    mass = core.parameters[0, 0]
    assert mass > 0.1
    heavy, light = Model(with_parameters(ARMS["slim"], {"payload_mass": mass})), Model(ARMS["slim"])
    check_by_scipy(core, lambda k, *x: (heavy if k < AT else light).accelerations(*x))


def test_targets_jump_within_the_range_of_the_tasks() -> None:
    core = Core(task="Reach", arm="slim", n_env=500, event="jump")
    for row in range(500):
        core.seed(row, np.random.default_rng(row))
    core.reset(np.arange(500))
    before, rows = core.joint_target(), core.signals.state.slices
    time = core.state[rows["event_time"], :500][0]
    low, high = np.array(TIME) * core.move_time / core.control_dt
    assert low <= time.min() < 1.1 * low
    assert 0.95 * high < time.max() < high
    for k in range(int(high) + 1):
        out = core.step(np.zeros((500, 1), np.float32))[0]
        jumped = (core.joint_target() != before).all(axis=1)
        np.testing.assert_array_equal(jumped, np.floor(time) <= k)
        np.testing.assert_array_equal(out.described()["event"], jumped)
    jump = core.joint_target() - before
    assert (np.abs(core.joint_target() - core.scales.home) <= EXTENT).all()
    assert 0.3 <= np.abs(jump).min() < 0.31
    assert 0.79 < np.abs(jump).max() <= 0.8
    assert (np.abs((jump > 0.0).mean(axis=0) - 0.5) < 0.1).all()


def test_targets_beyond_the_range_of_the_tasks_jump_towards_it() -> None:
    core = Core(task="Reach", arm="slim", n_env=20, event="jump")
    for row in range(20):
        core.seed(row, np.random.default_rng(row))
    core.reset(np.arange(20), {"target": np.repeat([[2.0], [-2.0]], 10, axis=0)})
    while not core.step(np.zeros((20, 1), np.float32))[0].described()["event"].all():
        pass
    assert (np.abs(core.joint_target()) < 1.7 + 1e-12).all()


@pytest.mark.parametrize("event", EVENTS)
def test_no_observation_shows_an_event_ahead(event: str) -> None:
    """Nor, of a drop, anything but its effect on the motion."""
    core = started(event)
    for k in range(STEPS):
        out = turned(core, k)
        assert np.array_equal(out.obs[0], out.obs[1]) == (k < AT), k
    assert out.described()["event"].tolist() == [1.0, 0.0]


def test_a_push_changes_the_momentum_of_a_floating_arm_by_its_impulse() -> None:
    """Linear momentum by F T: over a short step the force hardly turns."""
    envs: Any = gym.make_vec(
        "FlexArm/FreeFlyer-Reach-v0", num_envs=8, event="push", control_dt=1e-3, substeps=2
    )
    envs.reset(seed=0)
    core = envs.unwrapped.core
    placed(core, "event_time", 2.5)
    force = core.state[core.signals.state.slices["event_size"], :8][0]
    action = np.full((8, 2), 0.3, np.float32)
    infos = [envs.step(action)[-1] for _ in range(4)]
    before, after = infos[1], infos[2]
    tip = np.array([core.model.tip(q) for q in core.q])
    p = after["linear_momentum"] - before["linear_momentum"]
    np.testing.assert_allclose(np.linalg.norm(p, axis=1), force * 1e-3, rtol=1e-4)
    turn = after["angular_momentum"] - before["angular_momentum"]
    np.testing.assert_allclose(turn, tip[:, 0] * p[:, 1] - tip[:, 1] * p[:, 0], rtol=1e-2)


def test_a_dropped_payload_takes_its_momentum_along() -> None:
    """Its mass times the velocity of the tip; the momentum of the rest does not change."""
    envs: Any = gym.make_vec("FlexArm/FreeFlyer-Reach-v0", num_envs=8, event="drop", substeps=40)
    envs.reset(seed=0)
    core = envs.unwrapped.core
    placed(core, "event_time", 20.0)
    mass, action = core.parameters[:, 0].copy(), np.full((8, 2), 0.3, np.float32)
    for _ in range(20):
        before = envs.step(action)[-1]
    model, states = core.model, list(zip(core.q.copy(), core.v.copy(), strict=True))
    after = envs.step(action)[-1]
    assert (before["event"] == 0).all()
    assert (after["event"] == 1).all()
    tips = np.array([model.tip(q)[:2] for q, _ in states])
    taken = mass[:, None] * np.array([model.tip_velocity(q, v)[:2] for q, v in states])
    assert (np.linalg.norm(taken, axis=1) > 0.01).all()
    lost = before["linear_momentum"] - after["linear_momentum"]
    np.testing.assert_allclose(lost, taken, rtol=1e-3, atol=1e-5)
    turn = tips[:, 0] * taken[:, 1] - tips[:, 1] * taken[:, 0]
    lost = before["angular_momentum"] - after["angular_momentum"]
    np.testing.assert_allclose(lost, turn, rtol=1e-3, atol=1e-5)


def test_the_cost_is_the_excess_of_curvature() -> None:
    """Zero below the limit and at a start; full torque exceeds that of ReachStrain."""
    envs: Any = gym.make_vec("FlexArm/OneLink-ReachStrain-v0", num_envs=2)
    assert envs.reset(seed=0)[1]["cost"].tolist() == [0.0, 0.0]
    core = envs.unwrapped.core
    link = core.arm.links[0]
    limit = 0.4 * 0.1 * link.root_curvature("y") / link.length
    costs = []
    for k in range(20):
        info = envs.step(np.array([[0.3], [1.0]]) * (1.0 if k < 10 else -1.0))[-1]
        excess = np.abs(info["root_curvature"][:, 0]) / limit - 1.0
        np.testing.assert_allclose(info["cost"], np.maximum(excess, 0.0), atol=1e-12)
        costs.append(info["cost"].copy())
    assert np.max(costs, axis=0)[0] == 0.0 < 0.1 < np.max(costs, axis=0)[1]


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"event": "dorp"}, r"Unknown event 'dorp'"),
        ({"event": "jump", "arm": "free-flyer"}, r"event must be .* 'planar', got 'jump'"),
        ({"curvature_limit": 0.0}, r"curvature_limit must be positive, got 0\.0"),
        ({"curvature_limit": 0.4, "fidelity": "rigid"}, r"curvature_limit \(0\.4\) needs a link"),
        ({"event": "drop", "tolerance": 1e-3}, r"payload_mass"),
        ({"event": "push", "integrator": "rosenbrock"}, r"which a push does not give"),
    ],
)
def test_bad_events_and_limits_get_a_sentence(keywords: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Core(**({"task": "Reach", "arm": "slim", "control_dt": 0.02} | keywords))


def test_a_payload_bends_the_arm_under_gravity_until_it_is_dropped() -> None:
    """At the start by the equilibrium of the arm with the payload."""
    arm = replace(ARMS["slim"], gravity=(0.0, -9.81, 0.0), foreshortening=False)
    soft = replace(arm, links=(replace(arm.links[0], EIz=40.0),))
    core = Core(task="Reach", arm=soft, event="drop", torque_limit=20.0)
    core.seed(0, np.random.default_rng(0))
    core.reset(np.arange(1))
    mass, q = core.parameters[0, 0], core.q[0]
    expected = Model(with_parameters(soft, {"payload_mass": mass})).equilibrium(q[:1]).q
    np.testing.assert_allclose(q, expected, rtol=1e-6)
    assert np.abs(q[1] / Model(soft).equilibrium(q[:1]).q[1]) > 1.1
