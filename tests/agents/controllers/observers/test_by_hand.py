"""Filters against the textbook's and one another, on masses on springs: nothing is compiled."""

from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag

from agents.controllers.models.plan import TimedMoves
from agents.controllers.models.reading import Sensors
from agents.controllers.observers import extended
from agents.controllers.observers.extended import ExtendedFilters
from agents.controllers.observers.kalman import KalmanFilters
from dynamics.types import Array
from flexarm_env.hardware.sensors import Hardware
from tests.agents.controllers.observers.textbook import filtered
from tests.agents.controllers.springs import JOINTS, LIMIT, MODAL, READINGS, Environment, N

pytestmark = pytest.mark.usefixtures("springs_alone")
HARDWARE = Hardware(
    encoder_counts=4000, gauge_noise=0.01, gauge_bias=0.03, gauge_counts=500, delay=(0, 1)
)


def test_errors_of_sensors_are_those_of_the_hardware() -> None:
    core = SimpleNamespace(
        gauge_scale=[2.0, 3.0], arm=SimpleNamespace(n_joint=1),
        sensing=SimpleNamespace(hardware=HARDWARE),
    )  # fmt: skip
    found, gauges = Sensors.of(core), np.array([2.0, 3.0])
    assert (found.delay, found.delays) == ((0, 1), [0, 1, 2])
    np.testing.assert_allclose(found.quantum, [2.0 * np.pi / 4000, *gauges / 500])
    np.testing.assert_allclose(found.noise[0], 2.0 * np.pi / 4000 / 12**0.5)
    np.testing.assert_allclose(found.noise[1:], gauges * np.hypot(0.01, 1.0 / 500 / 12**0.5))
    np.testing.assert_allclose(found.bias, 0.03 * gauges / 3**0.5)
    for sensing in (None, SimpleNamespace(hardware=Hardware())):
        ideal = Sensors.of(SimpleNamespace(**vars(core) | {"sensing": sensing}))
        assert (ideal.delay, ideal.delays, ideal.bias.tolist()) == ((0, 0), [0], [0.0, 0.0])
        np.testing.assert_allclose(ideal.quantum, 1e-4 * np.array([1.0, 2.0, 3.0]))
        np.testing.assert_allclose(ideal.noise, ideal.quantum / 12**0.5)


def watched(env: Environment, filters: Any, count: int) -> tuple[Any, Any, Array, Array]:
    """Estimates and belief after readings (T, 2, y) and torques (T - 1, 2, m) of two episodes."""
    rng, belief = np.random.default_rng(0), None
    readings = 0.02 * rng.normal(size=(count, 2, 4)) * [1.0, 1.0, 3.0, 3.0]
    readings[1:3, 1] = readings[0, 1]  # as with a delay of two steps
    torques = 0.1 * LIMIT * rng.uniform(-1.0, 1.0, (count - 1, 2, 2))
    for k, reading in enumerate(readings):
        seen = env.observed(joint_error=reading[:, :2], root_curvature=reading[:, 2:])
        estimates, belief = filters.observe(seen, belief, np.full(2, k == 0))
        if k < count - 1:
            filters.act(belief, torques[k])
    return estimates, belief, readings, torques


@pytest.mark.parametrize("modes", [3, 4])
def test_filters_are_those_of_the_textbook(modes: int) -> None:
    """Of every plant and delay that the readings allow; the least surprised is believed."""
    env = Environment("sensors", hardware=HARDWARE, payloads=(0.0, 0.3), modes=modes)
    filters = KalmanFilters(env, "lqg", 0.05)
    assert filters.hypotheses == list(product(range(2), range(3)))
    estimates, belief, readings, torques = watched(env, filters, 8)
    spread = np.zeros((2, N, 2))
    spread[:, MODAL] = (
        0.4 / 3**0.5 * np.array([[[0.03, 0.005], [0.01, 0.02]], [[0.3, 0.1], [0.1, 0.3]]])
    )
    for i in range(len(estimates)):
        least = belief.surprise[i].argmin()
        for h, (p, delay) in enumerate(filters.hypotheses):
            if delay and i == 0:  # its second reading comes too early
                assert belief.surprise[i, h] == np.inf
                continue
            model = belief.banks[i].models[p]
            vibration = block_diag(*(model.modes @ x @ x.T @ model.modes.T for x in spread))
            x, surprise, now = filtered(
                model, filters, vibration, readings[:, i], torques[:, i], delay
            )
            np.testing.assert_allclose(belief.state[i, h, : len(x)], x, rtol=1e-7, atol=1e-12)
            assert belief.surprise[i, h] == pytest.approx(surprise)
            if h == least:
                assert estimates[i].model is model
                np.testing.assert_allclose(estimates[i].x, now, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("caution", [0.0, 1e9])
def test_filters_of_the_nonlinear_arm_are_those_of_a_linear_one(
    caution: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Surprises and estimates of an arm that is linear; with caution of the longest delay."""
    monkeypatch.setattr(extended, "REFUTED", np.inf)
    env = Environment("sensors", hardware=HARDWARE, payloads=(0.0, 0.3))
    found, linear = (
        watched(env, kind(env, "lqg", 0.05, caution=caution), 6)[:2]
        for kind in (ExtendedFilters, KalmanFilters)
    )
    for one, other in zip(found[0], linear[0], strict=True):
        assert one.model is other.model
        np.testing.assert_allclose(one.x, other.x, rtol=1e-7, atol=1e-10)
    alive = np.isfinite(found[1].surprise)
    assert alive.sum(axis=1).tolist() == [2, 6]
    np.testing.assert_allclose(found[1].surprise[alive], linear[1].surprise[alive])


def test_filters_about_a_plan_are_those_about_rest() -> None:
    """With readings, late by a control step, and torques about those of the plan."""
    env = Environment("sensors", hardware=Hardware(delay=1, encoder_counts=4000))
    plain = KalmanFilters(env, "lqg", 0.05)
    planned = KalmanFilters(env, "lqg", 0.05, TimedMoves(env, env.models, 0.5))
    rng, start, places = np.random.default_rng(0), np.array([0.1, -0.05]), []
    one, other = None, None
    for k in range(7):
        about = 0.01 * rng.normal(size=4) if k > 1 else np.zeros(4)
        shown = about + READINGS @ places[k - 1] if k > 1 else np.append(start, [0.0, 0.0])
        (found, one), (expected, other) = (
            filters.observe(
                env.observed(joint_error=y[None, :2], root_curvature=y[None, 2:]), belief,
                np.array([k == 0]),
            )
            for filters, belief, y in ((planned, one, shown), (plain, other, about))
        )  # fmt: skip
        places.append(one.place[0, -1, 0])
        if k == 0:  # but for what the first acceleration bends
            assert np.abs(one.state).max() < 1e-3
            np.testing.assert_allclose(places[0][JOINTS], start, atol=1e-3)
            one.state[:], one.surprise[:] = other.state, other.surprise
        else:
            np.testing.assert_allclose(found[0].x, expected[0].x, atol=1e-12)
        torque = 0.1 * rng.normal(size=(1, 2))
        planned.act(one, torque + found[0].forward)
        plain.act(other, torque)
    assert np.abs(found[0].forward).max() > 0.1
    assert one.surprise.item() == pytest.approx(other.surprise.item())


def test_careful_filters_believe_in_the_heaviest_plant() -> None:
    env = Environment("sensors", hardware=HARDWARE, payloads=(0.0, 0.3), factors=(0.9, 1.1))
    filters = KalmanFilters(env, "lqg", 0.05, caution=1e9)
    estimates, _, _, _ = watched(env, filters, 4)
    assert [estimate.model.plant for estimate in estimates] == [2, 2]  # and the softest


def test_what_filters_know_are_scaled_states_and_means_of_what_is_drawn() -> None:
    env = Environment("sensors", hardware=HARDWARE, payloads=(0.0, 0.3), factors=(0.9, 1.1))
    filters = KalmanFilters(env, "lqg", 0.05)
    estimates, belief, _, _ = watched(env, filters, 4)
    known = filters.known(belief)
    assert known.shape == (2, filters.n_known) == (2, 11)
    scales = np.empty((2, N))
    scales[:, JOINTS] = [0.5, 0.6], [2.0, 3.0]
    scales[:, MODAL] = [0.03, 0.02], [0.4, 0.3]
    likely = np.exp(-0.5 * (belief.surprise - belief.surprise.min(axis=1, keepdims=True)))
    drawn = np.array(
        [[2 * (p // 2) - 1, 2 * (p % 2) - 1, 2 * d - 1] for p, d in filters.hypotheses]
    )
    for i, estimate in enumerate(estimates):
        shapes = block_diag(estimate.model.shapes, estimate.model.shapes)
        np.testing.assert_allclose(known[i, :8], shapes @ estimate.x / scales.ravel())
        np.testing.assert_allclose(known[i, 8:], likely[i] @ drawn / likely[i].sum())
    alone = KalmanFilters(Environment("sensors"), "lqg", 0.05)
    assert alone.known(watched(env, alone, 2)[1]).shape == (2, alone.n_known) == (2, 8)
