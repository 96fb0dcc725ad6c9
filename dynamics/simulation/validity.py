"""Checks of a motion against the model's assumptions: deflection and joint rate."""

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.description.mode_shapes import BENDING
from dynamics.model import Model
from dynamics.simulation.trajectory import Trajectory
from dynamics.validity import bending

FARTHEST = 1e8  # [rad], [rad/s] largest state: sines of larger angles are inaccurate
LARGEST_RATE = 0.5  # [-] joint rate over the first frequency, joints locked, no foreshortening


def limits(model: Model, trajectory: Trajectory) -> tuple[str, ...]:
    """One sentence for each assumption of the model that a motion violates."""
    validate.instance(model, "model", Model)
    validate.instance(trajectory, "trajectory", Trajectory)
    return (
        *_rates(model, trajectory),
        *bending(model.arm, model.chain, model.bodies, trajectory.q),
    )


def loses_stiffness(arm: Arm) -> bool:
    """True for an arm whose bending modes soften where it turns fast: those without foreshortening.

    Springs of joints and torsion do not.
    """
    bends = any(link.in_direction(direction) for link in arm.links for direction in BENDING)
    return bends and not arm.foreshortening


def _rates(model: Model, trajectory: Trajectory) -> list[str]:
    joints = list(model.arm.joint_index)
    if not loses_stiffness(model.arm):
        return []
    first = float(model.frequencies(trajectory.q[0]).min())
    fastest = np.abs(trajectory.v[:, joints]).max(axis=0)
    return [
        f"Joint {i + 1} turns at up to {rate:.3g} rad/s, more than half the first frequency with "
        f"joints locked ({first:.3g} rad/s): linear modes lose stiffness; set Arm.foreshortening."
        for i, rate in zip(model.arm.joints, fastest.tolist(), strict=True)
        if model.arm.links[i].joint.type == "revolute" and rate > LARGEST_RATE * first
    ]
