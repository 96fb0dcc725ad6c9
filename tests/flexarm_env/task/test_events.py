"""Payloads that an event takes from an arm."""

import numpy as np
import pytest

from dynamics import Arm, Body, Joint, Link
from dynamics.formulations.linearized import inertia
from dynamics.model import Model
from flexarm_env.compiled.happening import Happening
from flexarm_env.task.events import EVENTS, check_event, payload

SLIDE = Joint(type="prismatic", rotation={"rpy": (0.0, 0.0, 0.3)})  # type: ignore[arg-type]
HEAVY = Link(length=0.5, rho_A=0.7, tip_mass=0.2, body=Body(mass=0.4), joint=SLIDE)
DISC = Link(length=0.0, body=Body(mass=0.0, inertia=np.eye(3).tolist()))


def test_a_dropped_payload_is_a_share_of_what_the_last_link_weighs() -> None:
    """Of the mass that its joint slides."""
    arm = Arm(links=(HEAVY, HEAVY))
    mass = inertia(Model(arm).chain, np.zeros(2))[1, 1]
    np.testing.assert_allclose(payload(arm, (0.1, 0.3)), (0.1 * mass, 0.3 * mass), rtol=1e-12)


def test_a_last_link_without_a_mass_drops_nothing() -> None:
    arm = Arm(links=(HEAVY, DISC))
    check_event("jump", arm)
    check_event("drop", Arm(links=(DISC, HEAVY)))
    with pytest.raises(ValueError, match="event 'drop' needs a last link with a mass"):
        check_event("drop", arm)


@pytest.mark.parametrize(("move", "steps"), [(2.0, 1), (14.0, 1), (16.0, 2), (50.0, 5)])
def test_a_push_lasts_a_tenth_of_a_move_but_a_control_step_at_least(
    move: float, steps: int
) -> None:
    """Its impulse is the same however long it lasts."""
    push = Happening("push", (1,), 1, move)
    sizes = push.ranges(3.0)[1]
    np.testing.assert_allclose(steps * sizes, 3.0 * np.array(EVENTS["push"].size), rtol=1e-12)
