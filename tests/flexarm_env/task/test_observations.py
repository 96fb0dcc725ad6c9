"""Directions that an observation holds, beside those in which a random arm's tip moves."""

from dataclasses import replace

import numpy as np
import pytest

from dynamics import Arm, Base, Joint, Link, Mode
from dynamics.model import Model
from flexarm_env.task.observations import is_level, observation_layout, sensed_axes
from flexarm_env.task.scales import scales
from flexarm_env.task.tasks import TASKS
from tests.dynamics.random_arms import random_state

OVER = {"axis": (1.0, 0.0, 0.0), "angle": np.pi}  # z of the joint is -z of the link before
UPRIGHT = {"axis": (1.0, 0.0, 0.0), "angle": np.pi / 2.0}
BEND, STRETCH = ("poly", "y"), ("axial-poly", "axial")
ALONG = {"planar": (0, 1), "spatial": (0, 1, 2)}


def link(*modes: tuple[str, str], **joint: object) -> Link:
    shapes = tuple(Mode(kind=kind, index=1, direction=along) for kind, along in modes)
    return Link(length=0.6, rho_A=0.5, EIz=20.0, EIy=20.0, EA=400.0, modes=shapes,
                joint=Joint(rotor_inertia=0.02, **joint))  # fmt: skip


ARMS = {
    "all along z": ("planar", link(BEND), link(BEND)),
    "the second along -z": ("planar", link(BEND), link(BEND, rotation=OVER)),
    "both along -z": ("planar", link(BEND, rotation=OVER), link(BEND)),
    "upright, the second along -z": ("planar", link(BEND, rotation=UPRIGHT),
                                     link(BEND, rotation=OVER)),
    "one above the other": ("planar", link(BEND), link(BEND, offset=(0.0, 0.0, 0.1))),
    "a link that stretches": ("planar", link(BEND, STRETCH), link(BEND)),
    "on a floating base, along -z": ("planar", link(BEND, rotation=OVER), link(BEND)),
    "bent out of the plane": ("spatial", link(BEND), link(("poly", "z"))),
    "the second across": ("spatial", link(BEND), link(BEND, rotation=UPRIGHT)),
    "the second a little aside": ("spatial", link(BEND), link(BEND, rotation={"rpy": (0.1, 0, 0)})),
}  # fmt: skip


@pytest.mark.parametrize("name", ARMS)
def test_an_observation_has_the_directions_in_which_the_tip_moves(name: str) -> None:
    motion, *links = ARMS[name]
    arm = Arm(links=tuple(links))
    if "floating" in name:
        arm = replace(arm, base=Base(type="planar", mass=1.0, inertia=np.eye(3)))
    model = Model(arm)
    states = [random_state(arm, seed) for seed in range(8)]
    moved = np.array([model.tip_velocity(q, v) for q, v in states])  # [m/s] in the world

    own = moved @ np.array(arm.links[0].joint.rotation)  # along the axes of the first link
    along = tuple(k for k in range(3) if np.abs(own[:, k]).max() > 1e-10)
    (part,) = [
        part
        for part in observation_layout(arm, TASKS["Reach"], "state", scales(arm), 1.0).parts
        if part.name == "tip_error"
    ]

    assert part.entries == along == ALONG[motion] == sensed_axes(arm)
    assert is_level(arm) == (np.abs(moved[:, 2]).max() < 1e-10)
