"""Kalman filters against the environment's own state, and against a textbook's filter."""

from typing import Any

import numpy as np
import pytest

from agents.controllers import controller
from agents.controllers.models.reading import Reading
from agents.controllers.observers import kalman
from agents.controllers.observers.kalman import KalmanFilters
from agents.leaderboard.tracks import keywords
from agents.metrics import make_batch
from tests.agents.controllers.observers.textbook import filtered
from tests.agents.toys import light_hub

WEIGHTS = {"effort": 0.01, "lead": 0.2, "clip": 0.5, "disturbance": 0.2}
REACH, DAMP, TRACK = (f"FlexArm/OneLink-{task}-v0" for task in ("Reach", "Damp", "Track"))


def watched(env_id: str, track: str, steps: int, n_env: int = 16) -> tuple[Any, Any, Any, Any]:
    """Environment, controller, its memory and last estimates after some steps."""
    kwargs = keywords("lqg", track)
    envs = make_batch(env_id, n_env, kwargs)
    subject: Any = controller("lqg", envs, WEIGHTS)
    observation, _ = envs.reset(seed=0)
    state: Any = None
    for _ in range(steps):
        action, state = subject.predict(observation, state, np.zeros(n_env, bool))
        observation = envs.step(action.astype(np.float32))[0]
    estimates, state = subject.observer.observe(observation, state, np.zeros(n_env, bool))
    return envs, subject, state, estimates


@pytest.mark.parametrize("env_id", [REACH, DAMP])
def test_filters_know_the_tip_better_than_the_late_encoder(env_id: str) -> None:
    """Tip error of the estimates, and of straight links at the read angles, from the true state."""
    envs, subject, _, estimates = watched(env_id, "laboratory", 15)
    core, joints = envs.unwrapped.core, subject.observer.models.joints
    read, found, naive = Reading.of(envs), [], []
    for i, estimate in enumerate(estimates):
        place = core.q[i].copy()
        place[joints] -= envs.unwrapped.joint_target()[i]
        model, r = estimate.model, len(estimate.model.modes)
        tip = model.tip_of @ place
        angle = read(core.outputs().obs[i], "joint_error")
        found.append(np.linalg.norm(model.tip @ estimate.x[:r] - tip))
        naive.append(np.linalg.norm(model.tip_of[:, joints] @ angle - tip))
    assert np.median(found) < 0.3 * np.median(naive)


@pytest.mark.parametrize("env_id", [REACH, DAMP])
def test_what_the_filters_know_is_what_exact_states_show(env_id: str) -> None:
    """Believed states in the scales of obs="state", without noise or delay.

    To a twentieth of the largest that was seen: LQG takes most of the vibration away.
    """
    envs, exact = (make_batch(env_id, 16, {"obs": obs}) for obs in ("sensors", "state"))
    subject: Any = controller("lqg", envs, WEIGHTS)
    observation, _ = envs.reset(seed=0)
    shown, _ = exact.reset(seed=0)
    state, largest = None, np.zeros_like(shown)
    for _ in range(30):
        action, state = subject.predict(observation, state)
        observation, before = envs.step(action.astype(np.float32))[0], shown
        largest = np.maximum(largest, np.abs(before))
        shown = exact.step(action.astype(np.float32))[0]
    parts = exact.unwrapped.observation_slices
    known, models = subject.known(state), subject.observer.models
    places, speeds = np.split(known, 2, axis=1)
    expected = [(places, models.joints, "joint_error"), (places, models.modal, "modal_amplitude")]
    expected += [(speeds, models.joints, "joint_rate"), (speeds, models.modal, "modal_rate")]
    for found, columns, name in expected:
        error = np.abs(found[:, columns] - before[:, parts[name]]).max()
        assert error < 0.05 * largest[:, parts[name]].max()


def test_on_a_path_the_filters_know_the_torque_that_follows_it() -> None:
    """It turns the straight arm as the target's rate is about to change, extrapolated."""
    envs = make_batch(TRACK, 8, {"obs": "sensors"})
    subject: Any = controller("lqg", envs, WEIGHTS)
    observation, _ = envs.reset(seed=0)
    state: Any = None
    rates, shown = [], []
    for _ in range(60):
        rates.append(subject.observer.read(observation, "target_rate"))
        action, state = subject.predict(observation, state)
        known = subject.known(state)
        assert known.shape == (8, subject.n_known)
        shown.append(known[:, -1:])  # nothing is drawn
        observation = envs.step(action.astype(np.float32))[0]
    model = subject.observer.models.model
    inertia = model.mass_matrix(np.zeros(model.n))[0, 0]
    change = np.diff(rates, axis=0) / envs.unwrapped.control_dt
    wanted = inertia * (2.0 * change[1:] - change[:-1]) / envs.unwrapped.torque_limit
    np.testing.assert_allclose(np.array(shown)[2:], wanted, atol=1e-3 * np.abs(wanted).max())


def test_the_filters_know_the_payload_the_stiffness_and_the_delay() -> None:
    """Means over the filters go from -1 to 1 with what is drawn."""
    ends = []
    for payload, stiffness, delay in ((0.0, 0.9, 0), (0.5, 1.1, 2)):
        hardware = {"preset": "laboratory", "delay": delay}
        hardware |= {"payload": (payload, payload), "stiffness": (stiffness, stiffness)}
        envs = make_batch(REACH, 16, {"hardware": hardware})
        subject: Any = controller("lqg", make_batch(REACH, 1, keywords("lqg", "laboratory")))
        observation, _ = envs.reset(seed=0)
        state: Any = None
        for _ in range(40):
            action, state = subject.predict(observation, state)
            observation = envs.step(action.astype(np.float32))[0]
        ends.append(subject.known(state)[:, -3:])
    assert np.all(np.median(ends[0], axis=0) < -0.5)
    assert np.all(np.median(ends[1], axis=0) > 0.5)


def test_surprises_are_as_large_as_the_covariances_say() -> None:
    """Squared innovations over their covariance average the number of readings (chi-square)."""
    hardware = {"preset": "laboratory", "delay": 0, "payload": (0.25, 0.25), "stiffness": (1, 1)}
    envs = make_batch(REACH, 64, {"hardware": hardware})
    filters = KalmanFilters(envs, "lqg", 1e-3)
    observation, _ = envs.reset(seed=0)
    belief: Any = None
    for k in range(30):
        _, belief = filters.observe(observation, belief, np.full(64, k == 0))
        torque = np.full((64, 1), 0.1 * (-1) ** (k // 5))
        filters.act(belief, torque)
        observation = envs.step((torque / filters.limit).astype(np.float32))[0]
    bulk = belief.banks[0].bulk[:30, 0].sum()
    squares = (belief.surprise[:, 0] - bulk) / 30
    assert 0.5 * 2 < squares.mean() < 1.5 * 2


@pytest.mark.parametrize(
    ("env_id", "kwargs"), [("FlexArm/TwoLink-Reach-v0", {}), (REACH, {"arm": light_hub()})]
)
def test_the_compiled_filters_are_kalman_filters(env_id: str, kwargs: dict[str, Any]) -> None:
    """State and surprise of a late filter, against the textbook's in plain NumPy.

    One arm has a mode that its filter leaves out, and that readings follow at once.
    """
    hardware = {"preset": "laboratory", "delay": 2, "payload": (0.2, 0.2), "stiffness": (1, 1)}
    envs = make_batch(env_id, 3, kwargs | {"hardware": hardware})
    filters = KalmanFilters(envs, "lqg", 0.05)
    m, rng = len(filters.limit), np.random.default_rng(0)
    observation, _ = envs.reset(seed=0)
    belief: Any = None
    readings, torques = [], []
    for _ in range(40):
        estimates, belief = filters.observe(observation, belief, np.full(3, belief is None))
        read = filters.read
        seen = [read(observation, "joint_error"), read(observation, "root_curvature")]
        readings.append(np.hstack(seen).astype(float))
        torques.append(rng.uniform(-0.3, 0.3, (3, m)) * filters.limit)
        filters.act(belief, torques[-1])
        observation = envs.step((torques[-1] / filters.limit).astype(np.float32))[0]
    for i in range(3):
        model, found = belief.banks[i].models[0], belief.state[i, 0]
        read, held = (np.array(x)[:, i] for x in (readings, torques[:-1]))
        x, surprise, now = filtered(model, filters, 0.0 * model.A, read, held, delay=2)
        np.testing.assert_allclose(found[: len(x)], x, rtol=1e-6, atol=1e-9)
        assert belief.surprise[i, 0] == pytest.approx(surprise, rel=1e-6)
        np.testing.assert_allclose(estimates[i].x, now, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("caution", [0.0, 4.0])
def test_a_careful_belief_is_the_heaviest_that_readings_allow(caution: float) -> None:
    """Among plants of one payload the softest; without caution the likeliest, by a plain search."""
    lab = make_batch(REACH, 16, keywords("lqg", "laboratory"))
    filters = KalmanFilters(lab, "lqg", 0.1, caution=caution)
    observation, _ = lab.reset(seed=0)
    belief: Any = None
    torque = np.full((16, 1), 0.3) * filters.limit
    for k in range(6):
        estimates, belief = filters.observe(observation, belief, np.full(16, k == 0))
        filters.act(belief, torque)
        observation = lab.step((torque / filters.limit).astype(np.float32))[0]
    differ = 0
    for i, estimate in enumerate(estimates):
        allowed = np.flatnonzero(belief.surprise[i] <= belief.surprise[i].min() + caution)
        plants = [filters.models.plants[filters.hypotheses[k][0]] for k in allowed]
        wanted = max(plants, key=lambda plant: (plant.payload, -plant.factor))
        index = filters.models.plants.index(wanted)
        assert estimate.model is belief.banks[i].models[index]
        differ += index != filters.hypotheses[belief.surprise[i].argmin()][0]
    assert (differ > 0) == (caution > 0.0)


def test_an_arm_settles_whose_second_mode_is_too_fast_for_the_filters() -> None:
    """The torque bends that mode at once: filters that do not expect it take it for a swing."""
    envs = make_batch(REACH, 8, {"obs": "sensors", "arm": light_hub()})
    lqg: Any = controller("lqg", envs, WEIGHTS)
    observation, _ = envs.reset(seed=0)
    state: Any = None
    for k in range(150):
        action, state = lqg.predict(observation, state, np.full(8, k == 0))
        observation, _, _, _, info = envs.step(action.astype(np.float32))
    assert np.all(info["tip_error"] < 0.05 * envs.unwrapped.reach)


def test_the_first_reading_repeats_for_as_long_as_the_delay() -> None:
    """Filters of a shorter delay are ruled out by readings that change too early, or too late."""
    for delay in (0, 1, 2):
        envs = make_batch(DAMP, 8, {"hardware": {"preset": "laboratory", "delay": delay}})
        filters = KalmanFilters(make_batch(DAMP, 1, keywords("lqg", "laboratory")), "lqg", 0.1)
        observation, _ = envs.reset(seed=0)
        belief: Any = None
        for _ in range(4):
            _, belief = filters.observe(observation, belief, np.full(8, belief is None))
            filters.act(belief, np.zeros((8, 1)))
            observation = envs.step(np.zeros((8, 1), np.float32))[0]
        best = [filters.hypotheses[k][1] for k in belief.surprise.argmin(axis=1)]
        assert np.mean(np.array(best) == delay) >= 0.75


def test_filters_expect_a_step_more_than_a_drawn_delay() -> None:
    for delay, expected in (((0, 2), [0, 1, 2, 3]), ((1, 1), [1])):
        envs = make_batch(REACH, 1, {"hardware": {"preset": "laboratory", "delay": delay}})
        assert KalmanFilters(envs, "lqg", 0.1).sensors.delays == expected


def test_filters_of_a_posture_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the start of an episode, even where no filters wait for the next one."""
    monkeypatch.setattr(kalman, "MEMORY", 0)
    envs = make_batch("FlexArm/TwoLink-Reach-v0", 4, {"obs": "sensors"})
    filters = KalmanFilters(envs, "lqg", 0.1)
    observation, _ = envs.reset(seed=0)
    belief: Any = None
    for _ in range(3):
        _, belief = filters.observe(observation, belief, np.full(4, belief is None))
        filters.act(belief, np.zeros((4, 2)))
    assert filters._bank.cache_info().misses == 4
