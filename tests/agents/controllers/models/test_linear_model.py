"""Plants of the linear models, and the memory for their postures."""

from dataclasses import replace

import numpy as np
import pytest

from agents.controllers.models import linear_model
from agents.controllers.models.linear_model import FASTEST, LinearModels
from agents.controllers.models.reading import Reading
from agents.controllers.models.reference import posture_of
from agents.metrics import make_batch
from dynamics import ARMS, Arm, Joint, Stepper, compile_arm
from tests.agents.toys import light_hub

REACH = "FlexArm/OneLink-Reach-v0"


def test_plants_are_spread_evenly_over_what_is_drawn_and_beyond() -> None:
    """By half of it on both sides, but no mass is negative; the middle is that of what is drawn."""
    envs = make_batch(REACH, 1, {"hardware": "laboratory"})
    models, drawn = LinearModels.of(envs), envs.unwrapped.core.randomize
    masses, factors = models.levels
    low, high = drawn["payload_mass"]
    assert masses == pytest.approx(np.linspace(low, low + 1.5 * (high - low), 10))
    low, high = drawn["stiffness"]
    assert factors == pytest.approx(np.linspace(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low, 5))
    assert [plant.factor for plant in models.plants] == factors * 10
    carried = [plant.model.arm.payload.mass for plant in models.plants]
    assert carried == pytest.approx(np.repeat(masses, 5))
    middle = models.plants[models.middle]
    assert middle.model.arm.payload.mass == pytest.approx(sum(drawn["payload_mass"]) / 2)
    assert middle.factor == pytest.approx(sum(drawn["stiffness"]) / 2)


def test_models_of_old_postures_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long trainings meet a new posture in every episode."""
    monkeypatch.setattr(linear_model, "KEPT", 2)
    core = make_batch("FlexArm/TwoLink-Reach-v0", 1).unwrapped.core
    models = LinearModels(core.arm, core.control_dt, ())
    for angle in range(5):
        models.at(np.array([0.0, float(angle)]))
    assert models._model.cache_info().currsize == 2


def test_models_have_the_friction_and_the_damping_that_are_drawn() -> None:
    """In the middle of their ranges, as an environment of a fit has them."""
    slim = ARMS["slim"]
    (link,) = slim.links
    drawn = {"viscous_1": (0.1, 0.3), "coulomb_1": (0.04, 0.04), "damping": (2.0, 3.0)}
    rubbing = replace(link.joint, viscous=link.joint.viscous + 0.2, coulomb=0.04)
    described = replace(slim, links=(
        replace(link, damping_ratio=2.5 * link.damping_ratio, joint=rubbing),
    ))  # fmt: skip
    of_drawn, of_described = (
        LinearModels.of(make_batch("FlexArm/OneLink-Reach-v0", 1, keywords))
        for keywords in ({"randomize": drawn}, {"arm": described})
    )
    np.testing.assert_allclose(of_drawn.plants[0].C, of_described.plants[0].C, rtol=1e-12)
    assert of_drawn.model.chain == of_described.model.chain


def test_readings_follow_torques_that_bend_what_is_left_out() -> None:
    """Against the simulated arm, whose second mode is too fast for the control step."""
    envs = make_batch(REACH, 1, {"obs": "sensors", "arm": light_hub()})
    core = envs.unwrapped.core
    model = LinearModels.of(envs).at(np.zeros(1))
    stepper = Stepper(compile_arm(core.arm), 1, dt=core.control_dt / 200, substeps=200)
    assert len(model.modes) < stepper.model.n
    state, gaps, sizes = np.zeros(len(model.A)), [], []
    for k in range(40):
        torque = stepper.torque[:, :] = 0.1 * np.sin([[0.2 * k]])
        stepper.advance()
        state = model.A @ state + model.B @ torque[0]
        reading = model.readings @ stepper.q[0]
        gaps.append(reading - model.C @ state - model.D @ torque[0])
        sizes.append(model.D @ torque[0])
    assert np.std(gaps, axis=0)[1] < 0.5 * np.std(sizes, axis=0)[1]


def test_the_first_angle_matters_where_a_fixed_link_before_it_bends() -> None:
    """Poles against those of the model linearized at the posture that is observed."""
    link = ARMS["two-link"].links[1]
    arm = Arm(links=(replace(link, joint=Joint(type="fixed")), link))
    envs = make_batch(REACH, 1, {"arm": arm, "obs": "state", "integrator": "rk4"})
    observation, _ = envs.reset(seed=0, options={"target": np.array([1.2])})
    models, read = LinearModels.of(envs), Reading.of(envs)
    found = models.at(posture_of(read, observation)[0])
    assert found.rest[models.joints] == pytest.approx([1.2], abs=1e-4)
    rest = np.zeros(arm.n)
    A, _ = models.model.linearize(found.rest, rest, np.zeros(1))
    slow = np.abs(np.linalg.eigvals(A)) < FASTEST / models.control_dt
    poles = np.exp(np.linalg.eigvals(A)[slow] * models.control_dt)
    np.testing.assert_allclose(np.poly(found.A), np.poly(poles), atol=1e-6)


def test_a_floating_base_is_refused() -> None:
    with pytest.raises(ValueError, match="take an arm on a fixed base, got 'planar'; use pd"):
        LinearModels.of(make_batch("FlexArm/FreeFlyer-Reach-v0", 1, {}))
