"""Checks of a motion against the model's assumptions: deflection and joint rate."""

import numpy as np

from dynamics.description import validate
from dynamics.model import Model
from dynamics.simulation.trajectory import Trajectory

FARTHEST = 1e8  # [rad], [rad/s] largest state: sines of larger angles are inaccurate
LARGEST_DEFLECTION = 0.1  # [-] tip deflection over length, of a link or segment
LARGEST_SLOPE = 0.15  # [rad] tip rotation of a link or segment
LARGEST_RATE = 0.5  # [-] joint rate over the first frequency, joints locked, no foreshortening


class ValidityWarning(UserWarning):
    """A motion violates an assumption of its model."""


def limits(model: Model, trajectory: Trajectory) -> tuple[str, ...]:
    """One sentence for each assumption of the model that a motion violates."""
    validate.instance(model, "model", Model)
    validate.instance(trajectory, "trajectory", Trajectory)
    return (*_rates(model, trajectory), *_bending(model, trajectory))


def _rates(model: Model, trajectory: Trajectory) -> list[str]:
    joints = list(model.arm.joint_index)
    if model.arm.foreshortening or model.n == model.n_joint + model.arm.base.n:
        return []
    first = float(model.frequencies(trajectory.q[0]).min())
    fastest = np.abs(trajectory.v[:, joints]).max(axis=0)
    return [
        f"Joint {i + 1} turns at up to {rate:.3g} rad/s, more than half the first frequency with "
        f"joints locked ({first:.3g} rad/s): linear modes lose stiffness; set Arm.foreshortening."
        for i, rate in zip(model.arm.joints, fastest.tolist(), strict=True)
        if model.arm.links[i].joint.type == "revolute" and rate > LARGEST_RATE * first
    ]


def _bending(model: Model, trajectory: Trajectory) -> list[str]:
    parts = list(zip(model.chain.links, model.chain.split(list(trajectory.q.T)), strict=True))
    result = []
    for i, (link, place) in enumerate(zip(model.arm.links, model.bodies, strict=True), 1):
        part = "link" if link.segments == 1 else "segment"
        deflection = slope = 0.0
        for body, (_, delta) in parts[place]:
            m = len(body.K)
            if m == 0:
                continue
            shift, turn = (
                np.linalg.norm(np.transpose(shapes[:m]) @ np.array(delta), axis=0).max()
                for shapes in (body.tip_phi, body.tip_theta)
            )
            deflection = max(deflection, float(shift) / body.length)
            slope = max(slope, float(turn))
        advice = f"expect errors, or raise Link.segments ({link.segments})."
        if deflection > LARGEST_DEFLECTION:
            result.append(
                f"Link {i} bends by up to {deflection:.0%} of the {part}'s length, more than "
                f"{LARGEST_DEFLECTION:.0%}: {advice}"
            )
        if slope > LARGEST_SLOPE:
            result.append(
                f"Link {i} turns the {part}'s tip by up to {slope:.2f} rad, more than "
                f"{LARGEST_SLOPE} rad: {advice}"
            )
    return result
