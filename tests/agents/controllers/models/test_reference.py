"""References along a path against the environment's own target, and a motion along them."""

from typing import Any

import numpy as np
import pytest

from agents.controllers import controller
from agents.controllers.models.linear_model import LinearModels
from agents.controllers.models.reading import Reading
from agents.controllers.models.reference import Course, Reference, followed, torques
from agents.leaderboard.tracks import keywords
from agents.metrics import make_batch
from dynamics import Arm, Joint, Link, Mode

TRACK = "FlexArm/OneLink-Track-v0"


def test_a_course_is_the_path_of_the_target() -> None:
    """Integrated and extrapolated from observed rates, against the environment's own target."""
    envs = make_batch(TRACK, 4, {"obs": "state"})
    read, dt = Reading.of(envs), envs.unwrapped.control_dt
    observation, _ = envs.reset(seed=3)
    start, targets, courses = envs.unwrapped.joint_target().copy(), [], []
    course = None
    for k in range(80):
        course = followed(read, observation, course, np.full(4, k == 0), dt)
        courses.append(course)
        targets.append(envs.unwrapped.joint_target() - start)
        observation = envs.step(np.zeros((4, 1), np.float32))[0]
    path = np.array(targets)
    curved = (path[2:] - 2.0 * path[1:-1] + path[:-2]) / dt**2
    assert np.abs(courses[-1].way - path[-1]).max() < 1e-5 * np.abs(path).max()
    coming = np.array([c.now for c in courses[1:-1]])
    assert np.median(np.abs(coming - curved)) < 0.005 * np.abs(curved).max()


def test_an_arm_on_its_reference_stays_there() -> None:
    """Weak feedback beside the reference's torque keeps the tip on the path."""
    envs = make_batch(TRACK, 4, {"obs": "state"})
    subject: Any = controller("lqr", envs, {"effort": 10.0, "lead": 0.1, "clip": 0.5})
    observation, _ = envs.reset(seed=0)
    state: Any = None
    errors = []
    for _ in range(100):
        action, state = subject.predict(observation, state, np.zeros(4, bool))
        observation, *_, info = envs.step(action.astype(np.float32))
        errors.append(info["tip_error"])
    assert np.sqrt(np.mean(np.square(errors))) < 2e-3 * envs.unwrapped.reach


def test_every_plant_bends_by_its_own_stiffness() -> None:
    """The links' elastic forces balance their inertial ones, and the tip stays on the path."""
    models = LinearModels.of(make_batch(TRACK, 1, keywords("lqg", "laboratory")))
    assert len({plant.factor for plant in models.plants}) > 1
    still, pushed = np.zeros((1, 1)), np.full((1, 1), 5.0)
    course = Course(still, still, still, pushed, pushed)
    offset, _ = Reference(models, range(len(models.plants))).along(course)
    straight, acceleration = np.zeros((2, models.model.n))
    acceleration[models.joints] = 5.0
    for p, plant in enumerate(models.plants):
        inertial = plant.model.inverse_dynamics(straight, straight, acceleration)
        elastic = plant.K @ offset[0, p]
        np.testing.assert_allclose(elastic[models.modal], -inertial[models.modal], rtol=1e-9)
        assert np.abs(models.at(straight[:1], p).tip_of @ offset[0, p]).max() < 1e-12


def test_every_plant_has_its_own_torques() -> None:
    """Payloads between the two, against each plant's inverse dynamics, on a moving arm."""
    models = LinearModels.of(
        make_batch("FlexArm/TwoLink-Track-v0", 1, keywords("lqg", "laboratory"))
    )
    assert len({plant.payload for plant in models.plants}) > 2
    rng = np.random.default_rng(0)
    course = Course(*rng.normal(size=(5, 3, 2)))
    _, forward = Reference(models, range(len(models.plants))).along(course)
    for p in range(len(models.plants)):
        np.testing.assert_allclose(forward[:, p], torques(models, course, p), rtol=1e-9)


@pytest.mark.parametrize(("kind", "share"), [("hierarchical", 0.01), ("pinned-free", 0.15)])
def test_the_joint_leads_by_what_a_uniform_acceleration_bends(kind: str, share: float) -> None:
    """11 rho_A a l^4 / 120 EI, so that the tip is where the straight link would be.

    Of pinned shapes, which torques at the root bend, many are needed.
    """
    modes = tuple(Mode(kind=kind, index=k + 1, direction="y") for k in range(6))
    link = Link(length=0.8, rho_A=0.4, EIz=6.0, modes=modes, joint=Joint(rotor_inertia=0.002))
    models = LinearModels(Arm(links=(link,)), 0.02, ())
    still, pushed = np.zeros((1, 1)), np.full((1, 1), 20.0)
    offset, _ = Reference(models, [0]).along(Course(still, still, still, pushed, pushed))
    lead = models.model.encoders @ offset[0, 0]
    assert lead == pytest.approx(11.0 * 0.4 * 20.0 * 0.8**4 / 120.0 / 6.0, rel=share)
