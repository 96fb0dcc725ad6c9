"""Quantities of an arm for its CHECKS, computed without compiling the arm."""

from collections.abc import Callable
from dataclasses import replace
from math import pi
from typing import Any

import numpy as np

from dynamics.description.arm import Arm
from dynamics.description.mode_shapes import Mode
from dynamics.formulations.linearized import frequencies, inertia, stiffness
from dynamics.formulations.link_constants import link_constants
from dynamics.formulations.newton_euler import inverse_dynamics, rigid_links
from dynamics.tracing.traced_arm import TracedArm


def hertz(arm: Arm, joints: str = "locked", angles: tuple[float, ...] | None = None) -> list[float]:
    """Natural frequencies [Hz] at joint angles [rad]; None: stretched. joints: "locked", "free"."""
    chain = TracedArm(arm).chain
    q = np.zeros(arm.n)
    if angles is not None:
        q[list(arm.joint_index)] = angles
    locked = arm.joint_index if joints == "locked" else ()
    elastic = arm.n - arm.n_joint - arm.base.n
    found = frequencies(inertia(chain, q), stiffness(chain), elastic, locked)
    return [float(w) / (2.0 * pi) for w in found]


def alone(arm: Arm, link: int, modes: int, kind: str = "clamped-tip-mass", **changes: Any) -> Arm:
    """Arm of one link (numbered from 0) with its tip body and `modes` shapes along y."""
    shapes = tuple(Mode(kind=kind, index=k, direction="y") for k in range(1, modes + 1))
    single = replace(arm.links[link], modes=shapes, segments=1, lumped=False, **changes)
    return Arm(links=(replace(single, joint=replace(single.joint, parallel=False)),))


def mode_of_arm(mode: int, angles: tuple[float, ...] | None = None) -> Callable[[Arm], float]:
    """Measure of a natural frequency [Hz] of the whole arm, joints locked; modes from 1."""
    return lambda arm: hertz(arm, "locked", angles)[mode - 1]


def mode_of_link(
    link: int, mode: int, modes: int = 6, kind: str = "clamped-tip-mass", joints: str = "locked"
) -> Callable[[Arm], float]:
    """Measure of a natural frequency [Hz] of one link `alone`; modes are numbered from 1."""
    return lambda arm: hertz(alone(arm, link, modes, kind), joints)[mode - 1]


def carried_inertia(arm: Arm, joint: int, angles: tuple[float, ...] | None = None) -> float:
    """Inertia [kg m^2] about a joint (numbered from 0), links straight, other joints locked."""
    q = np.zeros(arm.n)
    q[list(arm.joint_index)] = angles or (0.0,) * arm.n_joint
    k = arm.joint_index[joint]
    return float(inertia(TracedArm(arm).chain, q)[k, k])


def tip_spring(arm: Arm, link: int) -> float:
    """Tip stiffness [N m/rad]: (force times length) over (deflection / length), 3 EI / L of a beam.

    Quadratic and cubic shapes give the exact deflection of a cantilever under a tip load.
    """
    (beam,) = alone(arm, link, 2, "poly").links
    constants = link_constants(beam)
    tip = np.array(constants.tip_phi)[:, 1]
    return beam.length**2 / float(tip @ np.linalg.solve(np.array(constants.K), tip))


def mass(arm: Arm) -> float:
    """Mass [kg] of all links and tip bodies."""
    bodies = sum(link.body.mass for link in arm.links if link.body is not None)
    return bodies + sum(link.beam.line_mass.mass + link.tip_mass for link in arm.links)


def holding_load(arm: Arm, joint: int, posture: tuple[float, ...]) -> float:
    """Absolute torque [N m] or force [N] of a joint (from 0) that holds a rigid arm at rest."""
    rest = [0.0] * arm.n
    torques = inverse_dynamics(rigid_links(arm), posture, rest, rest, gravity=arm.gravity)
    return abs(float(torques[joint]))
