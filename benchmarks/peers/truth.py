"""Truths of the peers' scenes, written to tests/reference/NAME_exact_beam.csv."""

from dataclasses import replace

import numpy as np

from benchmarks.accuracy.model_choice import SpinUp
from benchmarks.peers.beam import beam, tips
from benchmarks.peers.scenes import SCENES, SPUN, SPUN_INERTIA, PeerScene
from benchmarks.work_precision.scenes import GOOD
from dynamics import Arm
from dynamics.accuracy.scene import JointMotion
from dynamics.types import Array

HEAVIER = 1e12  # [kg m^2] a rotor that the beam of S3 turns by less than 1e-10 of a radian
SIZES = {  # degree of theta and number of polynomials of the stretch: coarse, fine
    "S1": ((17, 0), (20, 0)),
    "S3": ((6, 3), (8, 4)),
    "korayem": ((14, 0), (18, 0)),
}


def driven(scene: PeerScene) -> tuple[Arm, JointMotion]:
    """Arm and motion of a scene; a prescribed root is even less moved by the beam."""
    if scene.arm is not SPUN:
        return scene.arm, scene.motion
    link = SPUN.links[0]
    link = replace(link, joint=replace(link.joint, rotor_inertia=HEAVIER))
    return Arm(links=(link,)), replace(scene.motion, torque=SpinUp(HEAVIER + SPUN_INERTIA))


def motion(scene: PeerScene, degree: int, stretch: int) -> Array:
    """(N, 3) t [s] and tip [m] of a scene's exact beams."""
    arm, load = driven(scene)
    return tips(beam(arm, degree, stretch, scene.axial), load, scene.interval)


def make_truths() -> None:
    """Write the truth of every scene, with the distance of a coarser beam as its accuracy."""
    for name, sizes in SIZES.items():
        scene = SCENES[name]
        coarse, fine = (motion(scene, *size) for size in sizes)
        apart = np.linalg.norm((fine - coarse)[:, 1:], axis=1).max() / scene.arm.reach
        degrees = " and ".join(str(degree) for degree, _ in sizes)
        extent = "with" if sizes[-1][1] else "without"
        head = (
            f"{scene.title}: geometrically exact beam {extent} stretch, angle of degree {degrees}, "
            f"by `python -m benchmarks.peers --truth`.\n{GOOD} {apart:.1e} of the reach, by which "
            "the degree moved the tip.\nt,tip_x,tip_y"
        )
        np.savetxt(scene.file, fine, "%.12g", ",", header=head)
        print(f"{scene.title}: {GOOD.lower()} {apart:.1e}", flush=True)
