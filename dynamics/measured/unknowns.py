"""Unknowns of a fit, a row each: parameters of the rig, and the state in which the log starts.

The state at the start is not the user's question, but the motion depends on it. Bending starts as a
sum of the arm's natural modes with its joints locked, as many as the samples can show. Their
amplitudes and rates are known to no more than the size of the arm. Faster modes rest, and those
that gravity bends do so at amplitudes of about their sag. Angles of joints start at the
first reading of the encoder, which is as noisy as the others, or within what a joint may have
turned between the first sample and a first reading that comes later or is itself late.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.linearized import inertia
from dynamics.model import Model
from dynamics.types import Array

Bounds = Mapping[str, tuple[float, float]]

ASKED = ("parameters", "torque", "gain", "delay", "lag")  # of the arm, motors and signals
LOCKED = 1e8  # [-] a locked rotor's inertia over the arm's
NO_SAG = 1e-9  # [-] amplitude of a mode, of its large size, that counts as none


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """A number that a fit estimates, and what it changes."""

    name: str
    into: str  # what it is added to: a key of `ASKED`, "zero" of sensors, "q" or "v" at the start
    direction: Array  # (p,), (n_torque,), (c,) or (n,) by one unit of it
    size: float  # a large change of it
    nominal: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    deviation: float = np.inf  # of the nominal value, where something is known beforehand
    reading: int | None = None  # signal whose noise the nominal value has


class Unknowns:
    """The rows of a fit as arrays of k numbers."""

    def __init__(self, rows: Sequence[Unknown]) -> None:
        self.names = [row.name for row in rows]
        self.nominal = np.array([row.nominal for row in rows])
        self.size = np.array([row.size for row in rows])
        self.low = np.array([row.low for row in rows])
        self.high = np.array([row.high for row in rows])
        self.asked = np.array([row.into in ASKED for row in rows])  # the others: the start
        self._rows = rows

    def changes(self, into: str, values: Array) -> Array:
        """(..., p), (..., c), (..., n) that values (..., k) add to parameters, signals, q, v."""
        chosen = [j for j, row in enumerate(self._rows) if row.into == into]
        if not chosen:
            return np.zeros(1)
        result: Array = values[..., chosen] @ np.stack([self._rows[j].direction for j in chosen])
        return result

    def precision(self, weights: Array) -> Array:
        """(k,) 1 / deviation of what is known beforehand, from 1 / deviation of the signals."""
        return np.array([
            1.0 / row.deviation if row.reading is None else weights[row.reading]
            for row in self._rows
        ])  # fmt: skip


def asked(bounds: Bounds, arm: Arm, signals: Sequence[str]) -> list[Unknown]:
    """Parameters of the arm, its motors and its signals, within their bounds (low, high).

    Friction of one joint, `viscous_1` and `coulomb_1`, is all of it, in SI units. `torque_1` scales
    the logged torque of a joint. `gain_encoder_1` scales a signal, `delay_encoder_1` [s] is the
    time by which it is late, `lag_encoder_1` [s] both time constants of a low pass before it.
    """
    joints = range(1, arm.n_joint + 1)
    words = [signal.replace(" ", "_") for signal in signals]
    groups = {
        "parameters": [name for name in FREE_PARAMETERS if name in bounds],
        "torque": [f"torque_{k}" for k in joints],
        "gain": [f"gain_{word}" for word in words],
        "delay": [f"delay_{word}" for word in words],
        "lag": [f"lag_{word}" for word in words],
    }
    places = {name: (into, unit) for into, names in groups.items()
              for name, unit in zip(names, np.eye(len(names)), strict=True)}  # fmt: skip
    known = [x for x in FREE_PARAMETERS if not (own := friction_of(x)) or own[1] in joints]
    known += [name for into in ASKED[1:] for name in groups[into]]
    for name in bounds:
        validate.known(name, "parameter", known)
    return [
        Unknown(
            name=name, into=places[name][0], direction=places[name][1], size=high - low,
            nominal=described(name, arm), low=low, high=high,
        )
        for name, (low, high) in bounds.items()
    ]  # fmt: skip


def friction_of(name: str) -> tuple[str, int] | None:
    """Field and joint, counted from 1, of a name such as `viscous_1`; None of another parameter."""
    word, _, number = name.rpartition("_")
    named = word in ("viscous", "coulomb") and number.isdecimal()
    return (word, int(number)) if named else None


def described(name: str, arm: Arm) -> float:
    """Value of a parameter of the arm, its motors or its signals before the fit."""
    if friction := friction_of(name):
        word, joint = friction
        return float(getattr(arm.links[arm.joints[joint - 1]].joint, word))
    if name in FREE_PARAMETERS:
        return FREE_PARAMETERS[name].nominal
    return 0.0 if name.startswith(("delay", "lag")) else 1.0


def without_friction(arm: Arm, names: Iterable[str]) -> Arm:
    """The arm less the friction of joints that parameters, by their names, add in full."""
    links = list(arm.links)
    for name in names:
        if friction := friction_of(name):
            word, joint = friction
            k, bare = arm.joints[joint - 1], {word: 0.0}
            links[k] = replace(links[k], joint=replace(links[k].joint, **bare))  # type: ignore[arg-type]
    return replace(arm, links=tuple(links))


def start(
    model: Model, q: Array, rotors: Array, rates: Mapping[int, float], waits: Array, period: float
) -> list[Unknown]:
    """The state at the start.

    Parameters
    ----------
    q : (n,) the straight arm at its first readings.
    rotors : (n_joint, n) angle of every rotor by q.
    rates : largest rate in the log of every free joint, in the order of the first signals.
    waits : [s] most time between the first sample and what the first reading of each tells.
    period : [s] between samples.
    """
    unit = np.eye(model.n)[list(model.arm.joint_index)]
    result = []
    for signal, (joint, rate) in enumerate(rates.items()):
        turn, name, wait = unit[joint], f"q{joint + 1}", float(waits[signal])
        read = {"deviation": rate * wait} if wait else {"reading": signal}
        result += [
            Unknown(name=name, into="q", direction=turn, size=1.0, **read),
            Unknown(name=f"{name} rate", into="v", direction=turn, size=rate, deviation=rate),
        ]
    shapes, omegas = locked_modes(model, q, rotors[list(rates)])
    rigidities = np.sum(shapes @ model.stiffness * shapes, axis=1)
    sags = -shapes @ model.bias(q, 0.0 * q) / rigidities
    most = float(np.abs(sags).max(initial=0.0))
    for k, (shape, omega) in enumerate(zip(shapes, omegas.tolist(), strict=True), 1):
        if omega * period < np.pi:
            for name, into, by in ((f"mode {k}", "q", 1.0), (f"mode {k} rate", "v", omega)):
                result.append(
                    Unknown(name=name, into=into, direction=by * shape, size=1.0, deviation=1.0)
                )
        elif most > NO_SAG:
            result.append(
                Unknown(
                    name=f"mode {k}", into="q", direction=shape, size=1.0, nominal=sags[k - 1],
                    deviation=most,
                )
            )  # fmt: skip
    return result


def zeros(names: Sequence[str], deviation: Array, n_encoder: int) -> list[Unknown]:
    """Readings of the signals, after the encoders, of the straight arm."""
    return [
        Unknown(
            name=f"zero of {name}", into="zero", direction=unit, size=size, deviation=size
        )
        for name, unit, size in zip(
            names[n_encoder:], np.eye(len(names))[n_encoder:], deviation[n_encoder:].tolist(),
            strict=True,
        )
    ]  # fmt: skip


def locked_modes(model: Model, q: Array, rotors: Array) -> tuple[Array, Array]:
    """Natural modes (m, n), each of a large size, with rotors (k, n) locked; rates (m,) [rad/s]."""
    n_mode = model.n - model.n_joint
    if not n_mode:
        return np.zeros((0, model.n)), np.zeros(0)
    M = inertia(model.chain, q)
    locked = M + LOCKED * (rotors.T * np.diag(rotors @ M @ rotors.T)) @ rotors
    squares, shapes = eigh(model.stiffness, locked)
    shapes = shapes.T[-n_mode:]
    sizes = np.abs(shapes * tips(model.chain)).max(axis=1, keepdims=True)
    return shapes / sizes, np.sqrt(np.maximum(squares[-n_mode:], 0.0))


def tips(chain: Chain) -> Array:
    """(n,) what a unit of each coordinate does: a tip's turn [rad], or its way over the length."""
    result: list[float] = []
    for link in chain.links:
        result += [] if link.welded else [1.0]
        result += [
            max(float(np.linalg.norm(turn)), float(np.linalg.norm(way)) / link.length)
            for way, turn in zip(link.tip_phi, link.tip_theta, strict=False)
        ]
    return np.array(result)
