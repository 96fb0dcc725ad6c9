"""Two motions of the certificate as a scene, on which models are chosen without compiling them."""

import numpy as np

from dynamics.accuracy.scene import JointMotion, Scene
from dynamics.description.arm import Arm
from dynamics.simulation.case_file import PiecewiseConstant, Torque
from flexarm_env.accuracy.conditions import Conditions
from flexarm_env.certify.episodes import Episodes, environment

STEPS = 40  # control steps of a motion
CHOSEN = ("white", "bang-bang")


def scene(arm: Arm, control_dt: float) -> tuple[Scene, Conditions]:
    """Motions at an arm's own torque limits, held over control steps [s], and their conditions."""
    core = environment(arm, 1, {"control_dt": control_dt})
    drawn = Episodes.drawn(core, CHOSEN, 1, STEPS)
    times = tuple((control_dt * np.arange(STEPS)).tolist())
    motions = []
    for q, actions in zip(drawn.q, drawn.actions.transpose(1, 2, 0), strict=True):
        torques = core.torque_limit[:, None] * actions
        signals = tuple(
            PiecewiseConstant(times=times, values=tuple(row.tolist())) for row in torques
        )
        motions.append(
            JointMotion(
                joint_angles=tuple(q[list(arm.joint_index)].tolist()),
                joint_rates=(0.0,) * arm.n_joint,
                t_end=control_dt * STEPS,
                torque=Torque(signals=signals),
                hold=control_dt,
            )
        )
    name = f"{' and '.join(CHOSEN)} torques for {control_dt * STEPS:g} s, held for {control_dt:g} s"
    return Scene(name=name, motions=tuple(motions)), core.conditions
