"""Errors of a step alone over episodes of random torques, from rest and with vibrating links.

Certificates start at rest, where fast modes are quiet. A method may keep the tip there and lose it
where they ring, as after the start of Damp. Another may keep the tip of an arm on a floating base
and lose its momentum.
"""

from typing import Any

import numpy as np

from dynamics import Stepper, compile_arm
from dynamics.description.arm import Arm
from dynamics.load import ArmSource, load_arm
from dynamics.types import AnyArray, Array
from flexarm_env.scales import DEFLECTION_LIMIT, SLOPE_PER_DEFLECTION, Scales, integration, scales
from flexarm_env.tasks import TASKS

EPISODES = 32  # from rest, and as many with vibrating links
RANDOM_STEPS = 40  # control steps of random torque
RANDOM_SHARE = 0.4  # largest random torque, over full torque
FINER = 4  # times the Runge-Kutta steps of an arm: the reference
EPISODE_ERROR = 1e-2  # [of the reach] above which a method is left out
MOMENTUM_ERROR = 1e-3  # [of the base's own momentum] above which it is, on a floating base


def episode_error(source: ArmSource, control_dt: float, integrator: str, substeps: int) -> float:
    """Largest tip error [of the reach] of the step alone, over EPISODES of Reach and of Damp.

    Infinite if one diverges that does not with finer steps. An episode counts until a link bends
    beyond its limit.
    """
    arm = load_arm(source)
    model, limit = compile_arm(arm), np.array(scales(arm).torque_limit)
    fine = FINER * integration(arm, control_dt, "rk4")[1]
    q, v = _starts(arm, scales(arm), np.random.default_rng(0))
    runs = [
        Stepper(model, len(q), dt=control_dt / count, substeps=count, integrator=name)
        for name, count in ((integrator, substeps), ("rk4", fine))
    ]
    for run in runs:
        run.q[:], run.v[:] = q, v
    rng, worst, going = np.random.default_rng(1), 0.0, np.ones(len(q), dtype=bool)
    for _ in range(RANDOM_STEPS):
        torque = limit * rng.uniform(-RANDOM_SHARE, RANDOM_SHARE, (len(q), limit.size))
        for run in runs:
            run.torque[:] = torque
            run.advance()
        lost = [_lost(run) for run in runs]
        if np.any(going & (runs[0].status != 0) & ~lost[1]):
            return float("inf")
        going &= ~(lost[0] | lost[1])
        tips = [run.measured[going][:, model.measurements["tip"]] for run in runs]
        worst = max(worst, float(np.linalg.norm(tips[0] - tips[1], axis=1).max(initial=0.0)))
    return worst / arm.reach


def keeps_tip(control_dt: float, arm: Arm, integrator: str, dt: float) -> bool:
    """True if whole steps of at most dt [s] per control step keep tip and momentum in episodes."""
    substeps = max(1, round(np.ceil(control_dt / dt - 1e-9)))
    if momentum_error(arm, control_dt, integrator, substeps) > MOMENTUM_ERROR:
        return False
    return episode_error(arm, control_dt, integrator, substeps) <= EPISODE_ERROR


def momentum_error(source: ArmSource, control_dt: float, integrator: str, substeps: int) -> float:
    """Largest drift of the momentum over an episode of Reach, from rest, on a floating base.

    It is relative to the largest momentum of the base alone, linear [N s] or about its own axis
    [N m s], and zero for a fixed base. Infinite if an episode diverges.
    """
    arm = load_arm(source)
    if not arm.base.n:
        return 0.0
    model, limit = compile_arm(arm), np.array(scales(arm).torque_limit)
    q, v = (x[:EPISODES] for x in _starts(arm, scales(arm), np.random.default_rng(0)))
    run = Stepper(model, len(q), dt=control_dt / substeps, substeps=substeps, integrator=integrator)
    run.q[:], run.v[:] = q, v
    rng, drift, largest = np.random.default_rng(1), np.zeros(2), np.zeros(2)
    for _ in range(RANDOM_STEPS):
        run.torque[:] = limit * rng.uniform(-RANDOM_SHARE, RANDOM_SHARE, (len(q), limit.size))
        run.advance()
        if np.any(run.status != 0):
            return float("inf")
        for q_now, v_now in zip(run.q, run.v, strict=True):
            own = arm.base.mass * v_now[:2], arm.base.inertia[2][2] * v_now[2:3]
            for sizes, parts in ((drift, model.momentum(q_now, v_now)), (largest, own)):
                sizes[:] = np.maximum(sizes, [np.linalg.norm(part) for part in parts])
    return float((drift / largest).max())


def _starts(arm: Arm, found: Scales, rng: Any) -> tuple[Array, Array]:
    """(2 EPISODES, n) coordinates and rates: half at rest, half with vibrating links."""
    joints = list(arm.joint_index)
    modal = [i for i in range(arm.base.n, arm.n) if i not in joints]
    q, v = np.zeros((2, 2 * EPISODES, arm.n))
    low, high = TASKS["Damp"].start
    q[:, joints] = found.home + rng.uniform(low, high, (2 * EPISODES, arm.n_joint))
    for x, shapes in ((q, found.vibration), (v, found.vibration_rate)):
        share = rng.uniform(*TASKS["Damp"].shake, (EPISODES, len(shapes)))
        x[EPISODES:, modal] = share @ np.reshape(shapes, (len(shapes), len(modal)))
    return q, v


def _lost(run: Stepper) -> AnyArray:
    """(N,) environments that diverged, or whose links bend beyond their limit."""
    at = run.model.measurements
    bent = np.abs(run.measured[:, at["deflection"]]).max(axis=1) > DEFLECTION_LIMIT
    slope = SLOPE_PER_DEFLECTION * DEFLECTION_LIMIT
    turned = np.abs(run.measured[:, at["slope"]]).max(axis=1) > slope
    return (run.status != 0) | bent | turned
