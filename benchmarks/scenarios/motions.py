"""Simulated motions of a scenario's arm and of its rigid twin, and their summary figures."""

import warnings
from dataclasses import dataclass
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.scenarios.file import Scenario
from dynamics import Arm, compile_arm, simulate
from dynamics.formulations.algebra import add, matvec
from dynamics.formulations.kinematics import Frame, outward
from dynamics.model import Model
from dynamics.simulation.nominal_motion import stiffened
from dynamics.simulation.trajectory import Trajectory
from dynamics.types import Array

RTOL = 1e-9
DEGREE = np.pi / 180.0


@dataclass(frozen=True)
class Run:
    """A simulated motion with the quantities that the pictures show."""

    model: Model
    path: Trajectory
    joints: Array  # (N, n_joint) [rad, m] between links: rotor coordinate plus joint spring
    rates: Array  # (N, n_joint) [rad/s, m/s]
    bend: Array  # (N, n_joint, 2) [m] deflection of each link's tip along y and z
    bend_rates: Array  # (N, n_joint, 2) [m/s]
    warnings: tuple[str, ...]  # of the model's validity


def twins(scenario: Scenario) -> tuple[Run, Run]:
    """Motions of the arm and of its rigid twin; the same object twice if the arm is rigid."""
    twin = stiffened(scenario.arm)
    first = follow(scenario, scenario.arm)
    return first, first if twin == scenario.arm else follow(scenario, twin)


def follow(scenario: Scenario, arm: Arm) -> Run:
    """Simulate one arm in a scenario."""
    model = compile_arm(arm)
    q, v = scenario.start(arm)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        path = simulate(model, q, v, scenario.torque, scenario.times, rtol=RTOL)
    messages = tuple(dict.fromkeys(str(warning.message) for warning in caught))
    joints, rates = (across(arm, x) for x in (path.q, path.v))
    return Run(model, path, joints, rates, *deflections(model, path.q, path.v), messages)


def across(arm: Arm, x: Array) -> Array:
    """(N, n_joint) joint coordinates plus the deflections of their springs, from x (N, n)."""
    columns = [
        x[:, k] + (x[:, k + 1] if link.joint.elastic else 0.0)
        for k, link in zip(arm.joint_index, arm.links, strict=True)
    ]
    return np.array(columns).T.reshape(len(x), len(columns))


def deflections(model: Model, q: Array, v: Array) -> tuple[Array, Array]:
    """(N, n_joint, 2) tip deflections [m] along y and z of the root frames, and rates [m/s]."""
    arm, count = model.arm, len(q)
    if model.n == arm.base.n + arm.n_joint:
        return np.zeros((count, arm.n_joint, 2)), np.zeros((count, arm.n_joint, 2))
    x, rate = ca.SX.sym("x", model.n), ca.SX.sym("rate", model.n)
    bent = [0.0] * arm.base.n + ca.vertsplit(x)[arm.base.n :]
    frames = outward(model.chain, bent, [0.0] * model.n)
    tips = [y for place in model.bodies for y in _tip(frames[place])[1:]]
    shift = ca.vertcat(*tips)
    function = ca.Function("tips", [x, rate], [shift, ca.jtimes(shift, x, rate)])
    found = function.map(count)(q.T, v.T)
    return tuple(np.array(y).T.reshape(count, arm.n_joint, 2) for y in found)  # type: ignore[return-value]


def _tip(bodies: list[Frame]) -> Any:
    """Tip of a link of welded segments, in the link's root frame."""
    pairs = list(zip(bodies[-2::-1], bodies[:0:-1], strict=True))
    return reduce(lambda tip, pair: add(pair[0].r, matvec(pair[1].R, tip)), pairs, bodies[-1].r)


def figures(scenario: Scenario, flexible: Run, rigid: Run) -> dict[str, Any]:
    """Figures of a scenario for the page."""
    arm, path = flexible.model.arm, flexible.path
    result: dict[str, Any] = {
        "coordinates": flexible.model.n,
        "integrator": path.integrator,
        "warnings": list(flexible.warnings),
    }
    if flexible is not rigid:
        sizes = np.linalg.norm(flexible.bend, axis=2).max(axis=0)
        largest = int(np.argmax(sizes))
        result |= {
            "deflection [mm]": 1e3 * float(sizes[largest]),
            "deflected link": largest + 1,
            "of its length [%]": 1e2 * float(sizes[largest]) / arm.links[largest].length,
            "joints apart [deg]": float(np.abs(flexible.joints - rigid.joints).max()) / DEGREE,
            "tips apart [mm]": 1e3 * float(np.linalg.norm(path.tip - rigid.path.tip, axis=1).max()),
        }
    return result | drifts(scenario, flexible)


def drifts(scenario: Scenario, run: Run) -> dict[str, float]:
    """Relative drifts: of energy without torque and damping, of a free base's momenta."""
    states = list(zip(run.path.q, run.path.v, strict=True))
    result = {}
    if scenario.torque is None and not _damped(run.model.arm):
        parts = np.array([run.model.energy(q, v) for q, v in states])
        total = parts.sum(axis=1)
        result["energy drift"] = float(np.abs(total - total[0]).max() / parts[:, 0].max())
    if run.model.arm.base.n and not any(run.model.arm.gravity):
        momenta = [run.model.momentum(q, v) for q, v in states]
        for name, values in zip(("linear", "angular"), zip(*momenta, strict=True), strict=True):
            change = np.linalg.norm(np.array(values) - values[0], axis=1).max()
            result[f"{name} momentum drift"] = float(change / np.linalg.norm(values[0]))
    return result


def _damped(arm: Arm) -> bool:
    return any(
        link.damping_ratio or link.damping_beta or link.joint.viscous or link.joint.coulomb
        or link.joint.spring_damping
        for link in arm.links
    )  # fmt: skip
