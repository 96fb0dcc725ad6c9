"""Two motions of the certificate as a scene, on which models are chosen without compiling them."""

import numpy as np

from dynamics.accuracy.scene import JointMotion, Scene
from dynamics.description.arm import Arm
from dynamics.simulation.case_file import PiecewiseConstant, Torque
from dynamics.simulation.statics import RigidArm
from flexarm_env.accuracy.conditions import Conditions
from flexarm_env.accuracy.motions import KINDS
from flexarm_env.task.scales import DEFLECTION_LIMIT, RIGID_PERIOD, scales

STEPS = 40  # control steps of a motion
CHOSEN = ("white", "bang-bang")


def scene(arm: Arm, control_dt: float) -> tuple[Scene, Conditions]:
    """Motions from rest at home at an arm's own torque limits, held over control steps [s].

    The conditions are those under which errors on the scene hold.
    """
    found = scales(arm)
    limit, home = np.array(found.torque_limit), np.array(found.home)
    period = 2.0 * np.pi / found.free[0] if found.free else RIGID_PERIOD
    rigid = RigidArm(arm)
    still = np.array([float(rigid.torque(j, home[None])[0]) for j in range(arm.n_joint)])
    times = tuple((control_dt * np.arange(STEPS)).tolist())
    motions = []
    for name in CHOSEN:
        actions, rng = KINDS[name].actions, np.random.default_rng(0)
        assert actions is not None
        shares = actions(rng, (STEPS, 1, arm.n_joint), control_dt / period)[:, 0]
        torques = np.clip(still + shares * found.motion_torque, -limit, limit)
        signals = tuple(
            PiecewiseConstant(times=times, values=tuple(row.tolist())) for row in torques.T
        )
        motions.append(
            JointMotion(
                joint_angles=found.home,
                joint_rates=(0.0,) * arm.n_joint,
                t_end=control_dt * STEPS,
                torque=Torque(signals=signals),
                hold=control_dt,
                settled=True,
            )
        )
    name = f"{' and '.join(CHOSEN)} torques for {control_dt * STEPS:g} s, held for {control_dt:g} s"
    conditions = Conditions(
        torque_limit=found.torque_limit, deflection_limit=DEFLECTION_LIMIT, ranges={}
    )
    return Scene(name=name, motions=tuple(motions)), conditions
