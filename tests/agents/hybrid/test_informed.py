"""Experts that are told what the observations of sensors hide."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agents.controllers import CONTROLLERS, controller
from agents.controllers.observers.exact import PLANT
from agents.hybrid.controller import description
from agents.hybrid.informed import Informed, Knowledge, expert
from agents.metrics import make_batch
from agents.tuned import parameters_of
from dynamics import load_arm
from dynamics.types import AnyArray

SEEDS = [3, 8, 21]
ONE, TWO = "FlexArm/OneLink-Track-v0", "FlexArm/TwoLink-Reach-v0"
DROP = "FlexArm/OneLink-TrackDrop-v0"


def pair(env_id: str, hardware: Any) -> tuple[Any, Any]:
    """Batches with sensors, and with exact states, in the same episodes of the same plants."""
    sensors = make_batch(env_id, len(SEEDS), {"hardware": hardware})
    drawn = sensors.unwrapped.core.randomize
    return sensors, make_batch(env_id, len(SEEDS), {"obs": "state", "randomize": drawn})


def reset(batches: tuple[Any, Any]) -> list[AnyArray]:
    return [batch.reset(seed=SEEDS)[0] for batch in batches]


@pytest.mark.parametrize("env_id", [ONE, TWO])
def test_the_told_state_is_what_an_environment_of_exact_states_observes(env_id: str) -> None:
    """All but the tip's error, which no controller of exact states reads."""
    batches = sensors, states = pair(env_id, "laboratory")
    (seen, exact), knowledge = reset(batches), Knowledge(sensors)
    rng = np.random.default_rng(0)
    for _ in range(30):
        told = knowledge.told(seen)
        for name, part in states.unwrapped.observation_slices.items():
            if name != "tip_error":
                np.testing.assert_allclose(told[:, part], exact[:, part], atol=1e-5, err_msg=name)
        action = rng.uniform(-0.3, 0.3, sensors.action_space.shape).astype(np.float32)
        seen, exact = (batch.step(action)[0] for batch in batches)


def test_the_told_plant_is_the_drawn_one() -> None:
    """And is nominal where nothing is drawn."""
    hardware = {"preset": "laboratory", "stiffness": None}
    sensors, _ = batches = pair(TWO, hardware)
    seen, _ = reset(batches)
    told = Knowledge(sensors)
    payload, factor = told.told(seen)[:, told.observation_slices[PLANT]].T
    np.testing.assert_array_equal(payload, sensors.unwrapped.core.parameters[:, 0])
    assert len(set(payload)) == len(SEEDS)
    np.testing.assert_array_equal(factor, 1.0)


@pytest.mark.parametrize(("name", "env_id"), [("mpc", ONE), ("lqr-planned", TWO)])
def test_a_told_expert_does_what_it_does_on_exact_states(name: str, env_id: str) -> None:
    """Of a plant that both know: one payload, one stiffness."""
    batches = pair(env_id, {"preset": "laboratory", "payload": (0.2, 0.2), "stiffness": (1.1, 1.1)})
    parameters = CONTROLLERS[name].middle
    told, knowing = expert(name, batches[0], parameters), controller(name, batches[1], parameters)
    seen, exact = reset(batches)
    memory = known = None
    assert isinstance(told, Informed)
    for _ in range(20):
        ours, memory = told.predict(seen, memory)
        action, known = knowing.predict(exact, known)
        np.testing.assert_allclose(ours, action, atol=1e-3)
        seen, exact = (batch.step(action.astype(np.float32))[0] for batch in batches)


def test_a_told_expert_assumes_the_plant_nearest_to_the_drawn_one() -> None:
    sensors, _ = batches = pair(TWO, "laboratory")
    seen, _ = reset(batches)
    informed: Any = expert("lqr", sensors, CONTROLLERS["lqr"].middle)
    _, memory = informed.predict(seen)
    models = informed._controller.observer.models
    steps = [level[1] - level[0] for level in models.levels]
    for model, drawn in zip(memory.models, sensors.unwrapped.core.parameters, strict=True):
        plant = models.plants[model.plant]
        apart = np.abs(np.array([plant.payload, plant.factor]) - drawn)
        assert np.all(apart <= 0.51 * np.array(steps))
    assert len({model.plant for model in memory.models}) > 1


def test_a_dropped_payload_is_no_longer_told() -> None:
    """The environment tells the drop itself; the models are those of the lightest plant."""
    sensors = make_batch(DROP, len(SEEDS), {"hardware": "laboratory"})
    seen, _ = sensors.reset(seed=SEEDS)
    informed: Any = expert("lqr", sensors, CONTROLLERS["lqr"].middle)
    knowledge, core = Knowledge(sensors), sensors.unwrapped.core
    dropped, memory = np.zeros(len(SEEDS)), None
    for _ in range(core.max_steps - 1):
        action, memory = informed.predict(seen, memory)
        payload = knowledge.told(seen)[:, knowledge.observation_slices[PLANT]][:, 0]
        np.testing.assert_array_equal(payload, core.parameters[:, 0] * (dropped == 0.0))
        models = informed._controller.observer.models
        drawn = np.stack([payload, core.parameters[:, 1]], axis=1)
        assert [model.plant for model in memory.models] == models.nearest(drawn).tolist()
        seen, _, ended, _, info = sensors.step(np.zeros_like(action, dtype=np.float32))
        dropped = info["event"]
        assert not ended.any()
    assert dropped.all()


RIGID = replace(load_arm("two-link"), links=tuple(
    replace(link, modes=(), EIz=None, joint=replace(link.joint, rotor_inertia=0.05))
    for link in load_arm("two-link").links
))  # fmt: skip
SPRUNG = replace(RIGID, links=tuple(
    replace(link, joint=replace(link.joint, stiffness=50.0)) for link in RIGID.links
))  # fmt: skip


def test_an_arm_without_gauges_has_its_state_told() -> None:
    """Joint springs bend it; without them the expert says what it takes."""
    sensors = make_batch(TWO, len(SEEDS), {"hardware": "laboratory", "arm": SPRUNG})
    assert "root_curvature" not in sensors.unwrapped.observation_slices
    told = expert("lqr", sensors, CONTROLLERS["lqr"].middle)
    assert isinstance(told, Informed)
    seen, _ = sensors.reset(seed=SEEDS)
    assert np.isfinite(told.predict(seen)[0]).all()
    rigid = make_batch(TWO, len(SEEDS), {"hardware": "laboratory", "arm": RIGID})
    with pytest.raises(ValueError, match="lqr takes an arm that bends"):
        expert("lqr", rigid, CONTROLLERS["lqr"].middle)


def test_a_told_expert_has_its_parameters_of_exact_states() -> None:
    """Hardware may hide the state; other keywords change the task."""
    found, laboratory = parameters_of("mpc", ONE, "state"), {"hardware": "laboratory"}
    assert description("mpc", "distilled", 0.3, ONE, laboratory)["parameters"] == found
    for learned, kwargs in (
        ("residual", laboratory),
        ("distilled", laboratory | {"reward": "tip"}),
    ):
        with pytest.raises(ValueError, match="mpc was not tuned"):
            description("mpc", learned, 0.3, ONE, kwargs)


def test_a_controller_that_reads_the_sensors_is_told_nothing() -> None:
    sensors, states = pair(TWO, "laboratory")
    assert not isinstance(expert("lqg", sensors, CONTROLLERS["lqg"].middle), Informed)
    assert not isinstance(expert("lqr", states, CONTROLLERS["lqr"].middle), Informed)
