"""Gravity on an arm at rest with straight links: torques that hold it, and its sag."""

from dataclasses import dataclass

import numpy as np

from dynamics.description.arm import Arm
from dynamics.formulations.gibbs_appell import bias
from dynamics.formulations.link_constants import chain_constants
from dynamics.model import Model
from dynamics.types import Array

_STARTS = 24  # postures from which the search for the largest torque begins
_SWEEPS = 4  # through all joints; the torque at each is a sine of its angle
_QUARTER = 0.5 * np.pi
_ROUND_OFF = 1e-12  # [-] of the weight times the reach


@dataclass(frozen=True)
class Held:
    """Largest holding torques over a range of postures."""

    torque: Array  # (n_joint,) [N m] that holds each joint
    postures: Array  # (n_joint, n_joint) [rad] at which it is needed


class RigidArm:
    """Potential energy of many postures at once, links straight."""

    def __init__(self, arm: Arm) -> None:
        self.gravity = np.array(arm.gravity)
        self.links = [body for bodies in chain_constants(arm) for body in bodies]
        mass = sum(body.mass + body.tip_mass for body in self.links)
        self.weight = mass * float(np.linalg.norm(self.gravity))  # [N]

    def energy(self, angles: Array) -> Array:
        """(N,) [J] at (N, n_joint) [rad]."""
        count = len(angles)
        energy = np.zeros(count)
        tip, base = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        joints = iter(np.transpose(angles))
        for body in self.links:
            joint = tip + base @ np.array(body.offset)
            R = base @ np.array(body.rotation)
            turn = _turn(next(joints) if body.driven else np.zeros(count))
            base = R = R @ turn
            tip = joint + R @ np.array((body.length, 0.0, 0.0))
            moment = body.mass * joint + R @ np.array(body.first_moment) + body.tip_mass * tip
            if any(body.tip_moment):
                moment = moment + R @ np.array(body.tip_moment)
            energy -= moment @ self.gravity
            if body.bypassed:
                base = R @ np.swapaxes(turn, 1, 2)
        return energy

    def torque(self, joint: int, angles: Array) -> Array:
        """(N,) [N m] that holds a joint: the slope of the energy, a sine of the joint's angle."""
        step = _QUARTER * (np.arange(angles.shape[1]) == joint)
        return 0.5 * (self.energy(angles + step) - self.energy(angles - step))


def held(arm: Arm, home: Array, extent: float) -> Held:
    """Largest holding torques with every joint within `extent` of `home` (n_joint,) [rad].

    As a function of any one angle a holding torque is a constant and a sine, so its largest value
    in an interval is known; the joints take turns.
    """
    n = arm.n_joint
    torque, postures = np.zeros(n), np.tile(home, (n, 1))
    if not any(arm.gravity):
        return Held(torque, postures)
    rigid, rng = RigidArm(arm), np.random.default_rng(0)
    for joint in range(n):
        for sign in (1.0, -1.0):
            angles = home + rng.uniform(-extent, extent, (_STARTS, n))
            for _ in range(_SWEEPS):
                for j in range(n):
                    angles[:, j] = _best(
                        rigid, joint, sign, angles, j, (home[j] - extent, home[j] + extent)
                    )
            found = np.abs(rigid.torque(joint, angles))
            k = int(np.argmax(found))
            if found[k] > torque[joint]:
                torque[joint], postures[joint] = found[k], angles[k]
    negligible = _ROUND_OFF * rigid.weight * arm.reach
    return Held(np.where(torque > negligible, torque, 0.0), postures)


def _best(
    rigid: RigidArm,
    joint: int,
    sign: float,
    angles: Array,
    turned: int,
    interval: tuple[float, float],
) -> Array:
    """(N,) angle of `turned` in an interval at which sign times the torque of `joint` peaks."""
    samples = []
    for k in range(3):
        moved = angles.copy()
        moved[:, turned] = 2.0 * np.pi * k / 3.0
        samples.append(sign * rigid.torque(joint, moved))
    waves = np.exp(2j * np.pi * np.arange(3) / 3.0)
    wave = np.array(samples).T @ waves  # c + i s of a + c cos q + s sin q, times 3/2
    low, high = interval
    middle = 0.5 * (low + high)
    peak = middle + (np.angle(wave) - middle + np.pi) % (2.0 * np.pi) - np.pi
    result: Array = np.clip(peak, low, high)  # beyond the interval, the end beside the peak
    return result


def sag(model: Model, angles: Array) -> Array:
    """(n,) linear static deflection of coordinates at joint angles (n_joint,) [rad]."""
    q = np.zeros(model.n)
    q[list(model.arm.joint_index)] = angles
    modal = [i for i in range(model.arm.base.n, model.n) if i not in model.arm.joint_index]
    force = -np.array(bias(model.chain, q.tolist(), model.n * [0.0]), dtype=np.float64)[modal]
    result = np.zeros(model.n)
    result[modal] = np.linalg.solve(model.stiffness[np.ix_(modal, modal)], force)
    return result


def _turn(angle: Array) -> Array:
    """(N, 3, 3) rotations about z."""
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(angle.size), np.ones(angle.size)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=1).reshape(-1, 3, 3)
