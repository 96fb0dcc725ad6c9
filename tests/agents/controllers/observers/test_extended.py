"""Filters of the nonlinear arm, against the arm, SciPy's integrator and the linear filters."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from agents.controllers.models.reading import Reading
from agents.controllers.observers import extended
from agents.controllers.observers.exact import ExactState
from agents.controllers.observers.extended import ExtendedFilters
from agents.controllers.observers.kalman import KalmanFilters
from agents.leaderboard.tracks import keywords
from agents.metrics import make_batch
from dynamics import compile_arm
from flexarm_env.task.observations import BOUND

DAMP, REACH, TRACK = (f"FlexArm/SixLink-{task}-v0" for task in ("Damp", "Reach", "Track"))
KNOWN = {"preset": "laboratory", "delay": 2, "payload": (0.2, 0.2), "stiffness": (1, 1)}
LABORATORY = keywords("lqg", "laboratory")


class Thrown:
    """Environments under steady torques of changing sign, and what filters make of them."""

    def __init__(self, env_id: str, kwargs: Any, *kinds: type[KalmanFilters], n_env: int = 4):
        self.envs = make_batch(env_id, n_env, kwargs)
        self.filters = [kind(self.envs, "lqg", 0.05) for kind in kinds]
        self.observation, _ = self.envs.reset(seed=0)
        self.beliefs: list[Any] = [None] * len(kinds)
        self.readings: list[Any] = []
        self.torques: list[Any] = []
        self.estimates = self.seen()

    def go(self, steps: int, share: float = 0.3, hold: int = 12) -> list[Any]:
        """Estimates of every kind of filter after some control steps."""
        limit, count = self.filters[0].limit, len(self.observation)
        for _ in range(steps):
            turn = np.arange(count)[:, None] + np.arange(limit.size) + len(self.torques) // hold
            sign = (-1.0) ** turn
            self.torques.append(share * sign * limit)
            for filters, belief in zip(self.filters, self.beliefs, strict=True):
                filters.act(belief, self.torques[-1])
            self.observation = self.envs.step((share * sign).astype(np.float32))[0]
            self.estimates = self.seen()
        return self.estimates

    def seen(self) -> list[Any]:
        """Estimates after the latest observation."""
        parts = ("joint_error", "root_curvature")
        read, x, found = Reading.of(self.envs), self.observation, []
        self.readings.append(np.hstack([read(x, part) for part in parts]).astype(float))
        for which, filters in enumerate(self.filters):
            belief = self.beliefs[which]
            estimates, self.beliefs[which] = filters.observe(x, belief, np.full(len(x), not belief))
            found.append(estimates)
        return found

    def errors(self, estimates: list[Any]) -> Any:
        """(N,) greatest error [rad], [m] of the estimated coordinates about the target."""
        core, joints = self.envs.unwrapped.core, self.filters[0].models.joints
        place = core.q.copy()
        place[:, joints] -= self.envs.unwrapped.joint_target()
        shown = np.array([coordinates(estimate)[0] for estimate in estimates])
        return np.abs(shown - place).max(axis=1)


def test_fast_links_are_followed_where_linear_filters_lose_them() -> None:
    """Errors of all coordinates while six links are thrown about, payload and delay known."""
    thrown = Thrown(DAMP, {"hardware": KNOWN}, ExtendedFilters, KalmanFilters)
    nonlinear, linear = map(thrown.errors, thrown.go(40))
    assert np.median(nonlinear) < 0.1 * np.median(linear)


def test_a_filter_integrates_the_arm_and_corrects_it_by_the_gains_of_the_linear_filters() -> None:
    """State of a late filter of two links; SciPy integrates the accelerations of the arm."""
    kwargs = {"hardware": KNOWN, "integrator": "rk4", "substeps": 400}
    thrown = Thrown("FlexArm/TwoLink-Reach-v0", kwargs, ExtendedFilters, n_env=2)
    (estimates,), (filters,), (belief,) = thrown.go(19, hold=3), thrown.filters, thrown.beliefs
    core, models, n = thrown.envs.unwrapped.core, filters.models, filters.models.model.n
    model = compile_arm(models.plants[0].model.arm)
    for i in range(2):
        bank, linear = belief.banks[i], belief.banks[i].models[0]
        posture, r = belief.plan.target.posture[i], len(linear.modes)
        q, v, bias = np.zeros(n), np.zeros(n), np.zeros(len(filters.sensors.bias))
        q[models.joints] = posture + thrown.readings[0][i, : len(posture)]
        for k in [0, *range(3, 20)]:  # readings 1 and 2 repeat the first
            if k:
                q, v = integrated(model, q, v, thrown.torques[k - 3][i], core.control_dt)
            straight = np.zeros(n)
            straight[models.joints] = posture
            expected = bank.readings @ (q - straight)
            expected[len(posture) :] += bias
            late = 0 if k == 0 else k - 2
            change = (thrown.readings[k][i] - expected) @ bank.gain[late, 0]
            q, v = q + linear.shapes @ change[:r], v + linear.shapes @ change[r : 2 * r]
            bias = bias + change[2 * r :]
        np.testing.assert_allclose(belief.state[i, 0, :n], q, atol=1e-7)
        np.testing.assert_allclose(belief.state[i, 0, n : 2 * n], v, atol=1e-5)
        np.testing.assert_allclose(belief.state[i, 0, 2 * n :], bias, atol=1e-7)
        for torque in thrown.torques[17:19]:
            q, v = integrated(model, q, v, torque[i], core.control_dt)
        about = np.concatenate([linear.modes @ (q - straight), linear.modes @ v])
        np.testing.assert_allclose(estimates[i].x, about, atol=1e-5)


def coordinates(estimate: Any) -> list[Any]:
    """Places and rates; modes of one frequency are not unique."""
    return [estimate.model.shapes @ x for x in np.split(estimate.x, 2)]


def integrated(model: Any, q: Any, v: Any, torque: Any, time: float) -> Any:
    """State of an arm after some time under constant torques."""

    def flow(_: float, x: Any) -> Any:
        return np.concatenate([x[model.n :], model.accelerations(*np.split(x, 2), torque)])

    found = solve_ivp(flow, (0.0, time), np.concatenate([q, v]), rtol=1e-9, atol=1e-11)
    return np.split(found.y[:, -1], 2)


def test_a_slow_link_is_estimated_as_by_linear_filters() -> None:
    """Places and rates of one link, which are nearly linear; payload and delay known."""
    env_id = "FlexArm/OneLink-Reach-v0"
    thrown = Thrown(env_id, {"hardware": KNOWN}, ExtendedFilters, KalmanFilters)
    nonlinear, linear = thrown.go(30, share=0.05)
    for found, expected in zip(nonlinear, linear, strict=True):
        for x, y in zip(coordinates(found), coordinates(expected), strict=True):
            assert np.abs(x - y).max() < 0.05 * np.abs(y).max()


@pytest.mark.parametrize("env_id", [TRACK, "FlexArm/TwoLink-Track-v0"])
def test_on_a_path_estimates_are_what_exact_states_show(env_id: str) -> None:
    """Places and rates about a moving reference, without noise or delay."""
    thrown = Thrown(env_id, {"obs": "sensors"}, ExtendedFilters)
    exact = make_batch(env_id, 4, {"obs": "state"})
    state, memory = ExactState(exact, "lqr"), None
    shown, _ = exact.reset(seed=0)
    (found,) = thrown.go(30, share=0.1)
    for torque in [*thrown.torques, None]:
        expected, memory = state.observe(shown, memory, np.full(4, memory is None))
        if torque is not None:
            shown = exact.step((torque / thrown.filters[0].limit).astype(np.float32))[0]
    for x, y in zip(found, expected, strict=True):
        for here, there in zip(coordinates(x), coordinates(y), strict=True):
            assert np.abs(here - there).max() < 0.05 * np.abs(there).max()


def test_refuted_filters_end_and_nothing_else_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Estimates are those of filters that never end; fewer than half are left."""
    found = {}
    for limit in (extended.REFUTED, np.inf):
        monkeypatch.setattr(extended, "REFUTED", limit)
        thrown = Thrown(REACH, LABORATORY, ExtendedFilters)
        found[limit] = thrown.go(30)[0], np.isfinite(thrown.beliefs[0].surprise).mean()
    (ending, few), (lasting, many) = found.values()
    assert few < 0.5 * many
    for x, y in zip(ending, lasting, strict=True):
        np.testing.assert_array_equal(x.x, y.x)


def test_what_observations_show_lies_within_their_bound_about_the_target() -> None:
    (filters,) = Thrown(REACH, {"obs": "sensors"}, ExtendedFilters, n_env=1).filters
    n, within = filters.models.model.n, BOUND * filters._scales.ravel()
    state, origin = np.zeros((4 * n, 2 * n)), np.random.default_rng(0).normal(size=(4 * n, n))
    state[:, :n] = origin
    state += np.vstack([0.999 * np.diag(within), -1.001 * np.diag(within)])
    shown = filters._shown(state, origin)
    assert np.all(shown[: 2 * n])
    assert not np.any(shown[2 * n :])


def test_where_every_filter_is_lost_all_begin_anew_and_find_the_arm_again() -> None:
    """They start at the angles that are read, and come within a tenth of filters never lost."""
    thrown = Thrown(REACH, {"obs": "sensors"}, *2 * [ExtendedFilters], n_env=2)
    thrown.go(10, share=0.02)
    filters, lost, read = thrown.filters[0], thrown.beliefs[0], Reading.of(thrown.envs)
    joints, posture = filters.models.joints, lost.plan.target.posture[1]
    lost.state[1] = 1e20
    thrown.go(1, share=0.02)
    state = np.zeros(lost.state.shape[2])
    state[joints] = posture + read(thrown.observation, "joint_error")[1]
    np.testing.assert_array_equal(lost.state[1], np.tile(state, (len(lost.state[1]), 1)))
    assert np.all(lost.surprise[1] == 0.0)
    (_, found), (_, kept) = thrown.go(40, share=0.02)
    for x, y in zip(coordinates(found), coordinates(kept), strict=True):
        assert np.abs(x - y).max() < 0.1 * np.abs(y).max()


def test_an_episode_is_estimated_alike_beside_others_and_alone() -> None:
    """Filters of several episodes share compiled steps; those of one use the same program."""
    (together,) = Thrown(REACH, {"hardware": KNOWN}, ExtendedFilters, n_env=3).go(15)
    (alone,) = Thrown(REACH, {"hardware": KNOWN}, ExtendedFilters, n_env=1).go(15)
    np.testing.assert_array_equal(together[0].x, alone[0].x)


def test_a_new_episode_forgets_the_one_before() -> None:
    """Estimates at a start are those of new filters, whatever was believed before."""
    thrown = Thrown(TRACK, LABORATORY, ExtendedFilters, n_env=2)
    thrown.go(10)
    filters = thrown.filters[0]
    observation, _ = thrown.envs.reset(seed=5)
    again, _ = filters.observe(observation, thrown.beliefs[0], np.array([True, True]))
    fresh, _ = filters.observe(observation, None, np.array([True, True]))
    for x, y in zip(again, fresh, strict=True):
        assert x.model is y.model
        np.testing.assert_array_equal(x.x, y.x)


def test_filters_are_told_of_other_torques() -> None:
    """Torques noted of a step are replaced, whole ones, not those about the reference."""
    thrown = Thrown(TRACK, LABORATORY, ExtendedFilters, n_env=2)
    thrown.go(5)
    (filters,), (belief,) = thrown.filters, thrown.beliefs
    before = belief.torque[:, -1].copy()
    filters.act(belief, np.ones((2, 6)))
    filters.told(belief, np.full((2, 6), 0.5))
    np.testing.assert_array_equal(belief.torque[:, -1], np.full_like(before, 0.5))
    np.testing.assert_array_equal(belief.torque[:, -2], before)
