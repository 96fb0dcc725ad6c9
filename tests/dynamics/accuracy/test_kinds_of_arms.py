"""Choices for moving bases, parallel drives, sliding joints, axial modes, sections: all hold.

Each claim is compared with another discretisation, compiled, under DOP853.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynamics import Arm, Base, Choice, Joint, Link, Mode, Scene, Section, choose_model, simulate
from dynamics.accuracy.fidelity import Fidelity, divisible, everything, rigid
from dynamics.accuracy.model_choice import _kinds
from dynamics.accuracy.scene import JointMotion, bang_bang
from dynamics.model import Model

BEAM = Link(
    length=0.8, rho_A=0.5, EIz=30.0, tip_mass=0.2, modes=(), joint=Joint(rotor_inertia=0.05)
)
STUB = Link(
    length=0.6, rho_A=0.6, EIz=400.0, tip_mass=0.2, modes=(), joint=Joint(rotor_inertia=0.1)
)
RIGID = Link(length=0.3, rho_A=1.0, tip_mass=1.0, joint=Joint(rotor_inertia=0.1))
SLIDER = replace(RIGID, joint=Joint(type="prismatic"))
PARALLEL = replace(BEAM, joint=Joint(rotor_inertia=0.05, parallel=True))
SOFT = replace(RIGID, EA=300.0, modes=(Mode(kind="axial-fixed-free", index=1, direction="axial"),))
BASE = Base(
    type="free", mass=4.0, inertia=((0.3, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 0.5)),
    position=(0.3, 0.1, 0.0), velocity=(0.1, 0.0, 0.0),
)  # fmt: skip
ROD = replace(
    BEAM, length=None, rho_A=0.0, EIz=None,
    sections=(
        Section(length=0.3, rho_A=1.0, EIz=90.0),
        Section(length=0.5, rho_A=(0.5, 0.2), EIz=(25.0, 8.0)),
    ),
)  # fmt: skip
CASES = {  # arm, torques, tolerance [m]
    "free base": (Arm(links=(BEAM,), base=BASE), (0.6,), 2e-3),
    "planar base": (Arm(links=(BEAM,), base=replace(BASE, type="planar")), (0.6,), 2e-3),
    "parallel drive": (Arm(links=(STUB, PARALLEL)), (2.0, 0.5), 3e-3),
    "sliding joint": (Arm(links=(SLIDER, BEAM)), (8.0, 0.5), 2e-3),
    "axial mode": (Arm(links=(SOFT,), gravity=(-9.81, 0.0, 0.0)), (0.5,), 1e-3),
    "sections": (Arm(links=(ROD,)), (0.6,), 1e-3),
}


def scene(name: str) -> Scene:
    return Scene(name=name, motions=(bang_bang(CASES[name][1], pulse=0.15, t_end=0.5),))


@cache
def chosen(name: str) -> Choice:
    arm, _, tolerance = CASES[name]
    return choose_model(arm, scene(name), tolerance)


def tips(arm: Arm, motion: JointMotion, times: np.ndarray, **how: object) -> np.ndarray:
    joints = arm.n - arm.base.n
    model, rest = Model(arm), np.zeros(joints)
    return simulate(model, rest, rest, motion.torque, times, **how).tip  # type: ignore[arg-type]


def independent(arm: Arm) -> Arm:
    """Another discretisation: three segments, or six modes of a link that has none."""
    cuts, fine, few = divisible(arm), everything(arm, 6, 3), everything(arm, 3, 2)
    counts = tuple(b if cut else a for a, b, cut in zip(fine, few, cuts, strict=True))
    segments = tuple(
        3 if cut and any(count) else 1 for cut, count in zip(cuts, counts, strict=True)
    )
    start = rigid(arm, foreshortening=True, polynomial=True)
    return replace(start, counts=counts, segments=segments).arm(arm)


@pytest.mark.parametrize("name", CASES)
def test_the_compiled_choice_is_as_good_as_claimed(name: str) -> None:
    arm, _, tolerance = CASES[name]
    choice, (motion,) = chosen(name), scene(name).motions
    times = np.linspace(0.0, motion.t_end, 1 + int(motion.t_end / max(choice.dt, 0.01)))
    truth = tips(independent(arm), motion, times, integrator="dop853", rtol=1e-8)
    stepped = tips(choice.arm, motion, times, integrator=choice.integrator, dt=choice.dt)
    apart = float(np.linalg.norm(stepped - truth, axis=1).max())
    assert apart <= choice.error + choice.residual <= tolerance
    still = tips(rigid(arm).arm(arm), motion, times, integrator="dop853", rtol=1e-8)
    assert np.linalg.norm(still - truth, axis=1).max() > tolerance  # the scene asks for modes


def test_a_link_before_a_parallel_drive_stays_in_one_piece_in_the_reference() -> None:
    choice = chosen("parallel drive")
    first, second = choice.reference.split(";")[:2]
    assert "link 1: " in first
    assert " x (" not in first
    assert " x (" in second
    assert divisible(CASES["parallel drive"][0]) == (False, True)


def test_large_deflections_before_a_parallel_drive_are_refused() -> None:
    arm = Arm(links=(replace(STUB, EIz=8.0), PARALLEL))
    sentence = r"link 1: it bends by \d+% of its length, and Joint.parallel of link 2 .*smaller"
    with pytest.raises(RuntimeError, match=sentence):
        choose_model(arm, scene("parallel drive"), 0.05)


def test_axial_modes_are_a_direction_only_where_the_arm_has_some() -> None:
    """A rigidity EA alone does not make models larger."""
    assert everything(CASES["axial mode"][0], 4, 2) == ((0, 0, 0, 2),)
    assert everything(Arm(links=(replace(SOFT, modes=()),)), 4, 2) == ((0, 0, 0),)
    assert str(Fidelity(counts=((0, 0, 0, 2),), segments=(1,))) == "link 1: 2 axial"
    (link,) = chosen("axial mode").arm.links
    assert {mode.direction for mode in link.modes} == {"axial"}
    assert all(kind.most_segments == (1,) for kind in _kinds(CASES["axial mode"][0])[0])
