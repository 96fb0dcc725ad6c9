"""Quantities of an arm that its CHECKS compare with published numbers; nothing is compiled."""

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
    """[Hz] natural frequencies at joint angles [rad], stretched if none are given."""
    chain = TracedArm(arm).chain
    q = np.zeros(arm.n)
    if angles is not None:
        q[list(arm.joint_index)] = angles
    held = arm.joint_index if joints == "locked" else ()
    elastic = arm.n - arm.n_joint - arm.base.n
    found = frequencies(inertia(chain, q), stiffness(chain), elastic, held)
    return [float(w) / (2.0 * pi) for w in found]


def alone(arm: Arm, link: int, modes: int, kind: str = "clamped-tip-mass", **changes: Any) -> Arm:
    """One link of an arm, numbered from 0, with its tip body and `modes` shapes along y."""
    shapes = tuple(Mode(kind=kind, index=k, direction="y") for k in range(1, modes + 1))
    single = replace(arm.links[link], modes=shapes, segments=1, **changes)
    return Arm(links=(replace(single, joint=replace(single.joint, parallel=False)),))


def mode_of_arm(
    mode: int, joints: str = "locked", angles: tuple[float, ...] | None = None
) -> Callable[[Arm], float]:
    """The measure of one of `hertz`, numbered from 1."""
    return lambda arm: hertz(arm, joints, angles)[mode - 1]


def mode_of_link(
    link: int, mode: int, modes: int = 6, kind: str = "clamped-tip-mass", joints: str = "locked"
) -> Callable[[Arm], float]:
    """The measure of one frequency [Hz], numbered from 1, of one link `alone`."""
    return lambda arm: hertz(alone(arm, link, modes, kind), joints)[mode - 1]


def carried_inertia(arm: Arm, joint: int, angles: tuple[float, ...] | None = None) -> float:
    """[kg m^2] what a joint, numbered from 0, turns of the straight-linked arm; others held."""
    q = np.zeros(arm.n)
    q[list(arm.joint_index)] = angles or (0.0,) * arm.n_joint
    k = arm.joint_index[joint]
    return float(inertia(TracedArm(arm).chain, q)[k, k])


def tip_spring(arm: Arm, link: int) -> float:
    """[N m/rad] tip force times length over tip deflection over length: 3 EI / L of a beam.

    Square and cubic shapes bend exactly as a tip load bends a cantilever.
    """
    (beam,) = alone(arm, link, 2, "poly").links
    constants = link_constants(beam)
    tip = np.array(constants.tip_phi)[:, 1]
    return beam.length**2 / float(tip @ np.linalg.solve(np.array(constants.K), tip))


def mass(arm: Arm) -> float:
    """[kg] of all links and bodies at their tips."""
    bodies = sum(link.body.mass for link in arm.links if link.body is not None)
    return bodies + sum(link.rho_A * link.length + link.tip_mass for link in arm.links)


def holding(arm: Arm, joint: int, posture: tuple[float, ...]) -> float:
    """[N m or N] size of what a joint, numbered from 0, holds of a rigid arm's weight."""
    rest = [0.0] * arm.n
    torques = inverse_dynamics(rigid_links(arm), posture, rest, rest, gravity=arm.gravity)
    return abs(float(torques[joint]))
