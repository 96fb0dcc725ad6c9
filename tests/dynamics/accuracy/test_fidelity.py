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
from dynamics.accuracy.fidelity import Fidelity, everything, fidelity_of
from dynamics.formulations import linearized
from dynamics.model import Model
from dynamics.types import Array

OWN = Link(
    length=0.9, rho_A=0.3, EIz=12.0, EIy=20.0, tip_mass=0.2, damping_ratio=0.03,
    modes=(Mode(kind="clamped-tip-mass", index=1, direction="y"),),
)  # fmt: skip
DAMPED = Link(
    length=0.9, rho_A=0.3, EIz=12.0, EIy=20.0, tip_mass=0.2, damping_ratio=0.03,
    tip_inertia=((0.0, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.03)),
    modes=tuple(Mode(kind="clamped-tip-mass", index=1, direction=d) for d in "yz"),
)  # fmt: skip


def ratios(arm: Arm, count: int) -> Array:
    """(count,) [-] damping ratios of the slowest modes with the joint locked, by eigenvalues."""
    chain, rest = Model(arm).chain, np.zeros(arm.n)
    M, K, C = (
        X[1:, 1:]
        for X in (
            linearized.inertia(chain, rest),
            linearized.stiffness(chain),
            linearized.damping(chain),
        )
    )
    n = len(M)
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ C]])
    roots = np.linalg.eigvals(A)
    slowest = sorted(roots[roots.imag > 0.0], key=abs)[:count]
    return np.array([-root.real / abs(root) for root in slowest])


@pytest.mark.parametrize(
    ("segments", "polynomial", "lumped", "count"),
    [(1, False, False, 6), (1, True, False, 6), (1, True, True, 2), (4, True, False, 8),
     (8, True, False, 8)],
)  # fmt: skip
def test_every_mode_has_the_damping_ratio_at_every_fidelity(
    segments: int, polynomial: bool, lumped: bool, count: int
) -> None:
    """In both directions of bending; the own shapes of `DAMPED` are natural."""
    bending = 1 if lumped else 3
    model = Fidelity(counts=((bending, bending, 0),), segments=(segments,), polynomial=polynomial,
                     lumped=lumped)  # fmt: skip
    arm = model.arm(Arm(links=(DAMPED,)))
    np.testing.assert_allclose(ratios(arm, count), 0.03, rtol=1e-6)


def test_a_payload_slows_the_first_mode_and_its_decay_alike_in_modes_and_segments() -> None:
    arm = Arm(links=(DAMPED,), payload=Payload(mass=0.5))
    found = [
        ratios(Fidelity(counts=((4, 0, 0),), segments=(k,), polynomial=True).arm(arm), 1)[0]
        for k in (1, 2, 4)
    ]
    np.testing.assert_allclose(found, found[0], rtol=1e-4)
    frequencies = [
        Model(replace(arm, payload=x)).frequencies(np.zeros(arm.n), joints="locked")[0]
        for x in (arm.payload, None)
    ]
    assert found[0] == pytest.approx(0.03 * frequencies[0] / frequencies[1], rel=0.02)


@pytest.mark.parametrize("inertia", [0.0, 2e-3])
@pytest.mark.parametrize(("segments", "modes"), [(1, 1), (1, 3), (4, 1), (6, 2)])
def test_torsion_decays_by_the_ratio_in_modes_and_in_segments(
    inertia: float, segments: int, modes: int
) -> None:
    tip = ((inertia, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    shaft = Link(length=0.9, rho_A=0.3, EIz=12.0, GJ=8.0, rho_Ip=1e-3, tip_inertia=tip,
                 damping_ratio=0.03, modes=())  # fmt: skip
    model = Fidelity(counts=((0, 0, modes),), segments=(segments,), polynomial=True)
    count = min(5, segments * modes)
    np.testing.assert_allclose(ratios(model.arm(Arm(links=(shaft,))), count), 0.03, rtol=1e-6)


def test_modes_beyond_the_fifth_of_segments_are_damped_more() -> None:
    arm = Fidelity(counts=((3, 0, 0),), segments=(4,), polynomial=True).arm(Arm(links=(DAMPED,)))
    found = ratios(arm, 8)
    np.testing.assert_allclose(found[:5], 0.03, rtol=1e-6)
    assert np.all(np.diff(found[4:]) > 0.0)


def test_twisting_without_a_stated_inertia_gets_that_of_a_metal_bar_or_a_thin_rod() -> None:
    def twisted(GJ: float, rho_Ip: float = 0.0) -> Link:
        arm = Arm(links=(replace(DAMPED, GJ=GJ, rho_Ip=rho_Ip),))
        return Fidelity(counts=((1, 0, 1),), segments=(2,), polynomial=True).arm(arm).links[0]

    assert twisted(8e3).rho_Ip == pytest.approx(8e3 / 3000.0**2)
    assert twisted(8.0).rho_Ip == pytest.approx(0.3 * (0.9 / 50) ** 2 / 2)
    stated = twisted(8.0, rho_Ip=1e-6)
    assert stated.rho_Ip == 1e-6
    straight = Fidelity(counts=((1, 0, 0),), segments=(2,), polynomial=True)
    assert straight.arm(Arm(links=(replace(DAMPED, GJ=8.0),))).links[0].rho_Ip == 0.0


def test_a_massless_twist_leaves_the_mass_matrix_of_a_bent_arm_positive() -> None:
    """With the inertia of a metal bar alone its least eigenvalue is -1.3e-7 kg m^2."""
    post = Link(length=0.25, rho_A=1.2, joint=Joint(rotor_inertia=0.05))
    beam = Link(length=0.6, rho_A=0.35, EIz=18.0, EIy=25.0, GJ=9.0, modes=())
    tip = Link(length=0.5, rho_A=0.2, EIz=6.0, EIy=8.0, tip_mass=0.3, modes=())
    counts = ((0, 0, 0), (1, 1, 1), (4, 4, 0))
    whole = Fidelity(counts=counts, segments=(1, 1, 1), foreshortening=True, polynomial=True)
    model = Model(whole.arm(Arm(links=(post, beam, tip))))
    q = np.zeros(model.n)
    q[5], q[[2, 6]] = 0.67, -0.04  # joint 3, first modes along y: 7 and 8 % of the lengths
    assert np.linalg.eigvalsh(model.mass_matrix(q))[0] > 0.0


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


def test_a_rigid_body_yields_in_no_direction() -> None:
    spun = Body(mass=1.0, inertia=tuple(map(tuple, np.eye(3))))
    body = Link(length=0.9, body=spun, EIz=12.0, modes=(), damping_ratio=0.03)
    assert everything(Arm(links=(DAMPED, body)), 2, 1) == ((2, 2, 0), (0, 0, 0))


def test_lumped_models_lump_flexible_links_and_say_so() -> None:
    rigid_link = replace(OWN, EIz=None, EIy=None, modes=(), damping_ratio=0.0)
    arm = Arm(links=(DAMPED, rigid_link))
    fidelity = Fidelity(
        counts=((2, 1, 0), (0, 0, 0)), segments=(1, 1), polynomial=True, lumped=True,
        foreshortening=True,
    )  # fmt: skip

    first, second = fidelity.arm(arm).links

    assert (first.lumped, second.lumped) == (True, False)
    assert [mode.kind for mode in first.modes] == 3 * ["hierarchical"]
    assert str(fidelity) == "link 1: 2 y + 1 z; link 2: rigid, polynomial, lumped, foreshortened"
    assert fidelity_of(fidelity.arm(arm)) == replace(fidelity, polynomial=False)
