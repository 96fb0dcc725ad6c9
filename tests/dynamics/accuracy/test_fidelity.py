"""Models of one arm have the same damping, whatever their modes and segments."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from dynamics import (
    Arm,
    Body,
    Joint,
    Link,
    Mode,
    Payload,
    simulate,
)
from dynamics.accuracy.certificate import fidelity_of
from dynamics.accuracy.fidelity import Fidelity, everything
from dynamics.formulations import linearized
from dynamics.formulations.damping import viscous
from dynamics.model import Model

OWN = Link(
    length=0.9, rho_A=0.3, EIz=12.0, EIy=20.0, tip_mass=0.2, damping_ratio=0.03,
    modes=(Mode(kind="clamped-tip-mass", index=1, direction="y"),),
)  # fmt: skip
DAMPED = Link(
    length=0.9, rho_A=0.3, EIz=12.0, EIy=20.0, tip_mass=0.2, damping_ratio=0.03,
    modes=(Mode(kind="clamped-free", index=1, direction="y"),),
)  # fmt: skip


def first_frequency(arm: Arm) -> float:
    """[rad/s] of one polynomial mode more than enough."""
    fine = Fidelity(counts=((5, 0, 0),), segments=(1,), polynomial=True).arm(arm)
    return float(Model(fine).frequencies(np.zeros(fine.n), joints="locked")[0])


def first_damping_ratio(arm: Arm) -> float:
    """[-] damping ratio of the slowest mode with the joint locked, from the linear matrices."""
    chain = Model(arm).chain
    M, K, C = (
        linearized.inertia(chain, np.zeros(arm.n)),
        linearized.stiffness(chain),
        linearized.damping(chain),
    )
    squares, S = eigh(K[1:, 1:], M[1:, 1:])
    return float(S[:, 0] @ C[1:, 1:] @ S[:, 0] / (2.0 * np.sqrt(squares[0])))


@pytest.mark.parametrize("payload", [None, Payload(mass=0.5)])
@pytest.mark.parametrize(("segments", "polynomial"), [(1, False), (1, True), (4, True), (8, True)])
def test_every_model_damps_a_first_mode_alike(
    payload: Payload | None, segments: int, polynomial: bool
) -> None:
    """Also modes and segments of the description; a payload slows the mode and its decay."""
    arm = Arm(links=(DAMPED,), payload=payload)
    expected = 0.03 * (first_frequency(arm) / first_frequency(replace(arm, payload=None)))
    model = Fidelity(counts=((3, 0, 0),), segments=(segments,), polynomial=polynomial).arm(arm)
    cut = replace(arm, links=(replace(model.links[0], damping_beta=0.0, damping_ratio=0.03),))
    exact = [replace(arm, links=(OWN,)), model] + ([cut] if segments > 1 else [])
    for each in exact:
        assert first_damping_ratio(each) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("inertia", [0.0, 2e-3])
@pytest.mark.parametrize(("segments", "modes"), [(1, 3), (4, 1), (6, 2)])
def test_torsion_decays_by_the_ratio_in_modes_and_in_segments(
    inertia: float, segments: int, modes: int
) -> None:
    tip = ((inertia, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    shaft = Link(length=0.9, rho_A=0.3, EIz=12.0, GJ=8.0, rho_Ip=1e-3, tip_inertia=tip,
                 damping_ratio=0.03, modes=())  # fmt: skip
    model = Fidelity(counts=((0, 0, modes),), segments=(segments,), polynomial=True)
    viscid = model.arm(Arm(links=(shaft,)))
    own = viscid.links[0].modes
    if segments == 1:  # a shape in the described frequency's mode
        own = (Mode(kind="torsion-fixed-free", index=1, direction="x"),)
    described = replace(viscid, links=(replace(shaft, modes=own, segments=segments),))
    for arm in (viscid, described):
        free = inertia == 0.0 or arm is viscid or segments > 1
        assert first_damping_ratio(arm) == pytest.approx(0.03, rel=1e-2 if free else 0.2)


@pytest.mark.compiles
def test_a_segmented_link_rings_down_as_its_ratio_says() -> None:
    """Peaks of a free vibration, in time: the joint is held by a large rotor inertia."""
    link = Link(length=1.0, rho_A=0.5, EIz=20.0, damping_ratio=0.02, joint=Joint(rotor_inertia=1e6),
                segments=4, modes=(Mode(kind="poly", index=1, direction="y"),
                                   Mode(kind="poly", index=2, direction="y")))  # fmt: skip
    model = Model(Arm(links=(link,)))
    squares, S = eigh(
        model.stiffness[1:, 1:],
        model.mass_matrix(
            np.zeros(9),
        )[1:, 1:],
    )
    period = 2.0 * np.pi / np.sqrt(squares[0])
    q = np.zeros(9)
    q[1:] = 1e-4 * S[:, 0] / np.abs(S[:, 0]).max()
    times = period * np.arange(6) / np.sqrt(1.0 - 0.02**2)
    tip = simulate(model, q, np.zeros(9), None, times).tip[:, 1]
    decrement = np.log(tip[0] / tip[-1]) / 5.0
    assert decrement == pytest.approx(2.0 * np.pi * 0.02 / np.sqrt(1.0 - 0.02**2), rel=1e-2)


def test_viscosities_follow_from_the_lowest_modes_and_need_a_damping_ratio() -> None:
    both, stiff = viscous(DAMPED), viscous(replace(DAMPED, EIz=0.0, modes=()))
    assert both.damping_beta == pytest.approx(stiff.damping_beta * np.sqrt(20.0 / 12.0), rel=1e-9)
    assert both.damping_ratio == stiff.damping_ratio == 0.0
    assert both.damping_beta_torsion is None
    shaft = viscous(replace(DAMPED, GJ=8.0, rho_Ip=1e-3))  # first frequency pi/2 c/l
    speed = np.sqrt(8.0 / 1e-3)
    assert shaft.damping_beta_torsion == pytest.approx(0.06 / (0.5 * np.pi / 0.9 * speed), rel=1e-9)
    assert shaft.damping_beta == both.damping_beta
    spun = Body(mass=1.0, inertia=tuple(map(tuple, np.eye(3))))
    body = Link(length=0.9, body=spun, EIz=12.0, modes=(), damping_ratio=0.03)
    rigid = replace(DAMPED, EIz=0.0, EIy=0.0, modes=())
    for link in (replace(DAMPED, damping_ratio=0.0), rigid, body):
        assert viscous(link) is link
    assert everything(Arm(links=(DAMPED, body)), 2, 1) == ((2, 2, 0), (0, 0, 0))


def test_lumped_models_lump_flexible_links_and_say_so() -> None:
    rigid_link = replace(OWN, EIz=None, EIy=None, modes=(), damping_ratio=0.0)
    arm = Arm(links=(OWN, rigid_link))
    fidelity = Fidelity(
        counts=((2, 1, 0), (0, 0, 0)), segments=(1, 1), polynomial=True, lumped=True,
        foreshortening=True,
    )  # fmt: skip

    first, second = fidelity.arm(arm).links

    assert (first.lumped, second.lumped) == (True, False)
    assert [mode.kind for mode in first.modes] == 3 * ["hierarchical"]
    assert str(fidelity) == "link 1: 2 y + 1 z; link 2: rigid, polynomial, lumped, foreshortened"
    assert fidelity_of(fidelity.arm(arm)) == replace(fidelity, polynomial=False)
