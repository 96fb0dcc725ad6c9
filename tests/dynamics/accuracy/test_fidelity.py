"""Models of one arm have the same damping, whatever their modes and segments."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from dynamics import (
    Arm,
    Body,
    Link,
    Mode,
    Payload,
    Trajectory,
    limits,
)
from dynamics.accuracy.fidelity import Fidelity, everything
from dynamics.formulations import linearized
from dynamics.formulations.damping import viscous
from dynamics.model import Model

DAMPED = Link(
    length=0.9, rho_A=0.3, EIz=12.0, EIy=20.0, tip_mass=0.2, damping_ratio=0.03,
    modes=(Mode(kind="clamped-free", index=1, direction="y"),),
)  # fmt: skip


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


def limits_at_rest(arm: Arm) -> tuple[str, ...]:
    still = np.zeros((1, arm.n))
    return limits(Model(arm), Trajectory(np.zeros(1), still, still, np.zeros((1, 3))))


@pytest.mark.parametrize("payload", [None, Payload(mass=0.5)])
@pytest.mark.parametrize(("segments", "polynomial"), [(1, False), (1, True), (4, True)])
def test_every_model_damps_a_first_mode_by_the_described_ratio(
    payload: Payload | None, segments: int, polynomial: bool
) -> None:
    """Also with segments, on which the described ratio alone would damp hardly at all."""
    arm = Arm(links=(DAMPED,), payload=payload)
    model = Fidelity(counts=((3, 0, 0),), segments=(segments,), polynomial=polynomial)
    assert first_damping_ratio(model.arm(arm)) == pytest.approx(0.03, rel=2e-3)
    if segments > 1:
        cut = replace(arm, links=(replace(DAMPED, segments=segments),))
        assert first_damping_ratio(cut) < 0.2 * 0.03
        (sentence,) = limits_at_rest(cut)
        beta = model.arm(arm).links[0].damping_beta
        assert f"set damping_beta={beta:.3g} instead" in sentence
        assert limits_at_rest(model.arm(arm)) == ()


def test_viscosity_follows_from_the_slowest_direction_and_needs_a_damping_ratio() -> None:
    both, stiff = viscous(DAMPED), viscous(replace(DAMPED, EIz=0.0, modes=()))
    assert both.damping_beta == pytest.approx(stiff.damping_beta * np.sqrt(20.0 / 12.0), rel=1e-9)
    assert both.damping_ratio == stiff.damping_ratio == 0.0
    spun = Body(mass=1.0, inertia=tuple(map(tuple, np.eye(3))))
    body = Link(length=0.9, body=spun, EIz=12.0, modes=(), damping_ratio=0.03)
    rigid = replace(DAMPED, EIz=0.0, EIy=0.0, modes=())
    for link in (replace(DAMPED, damping_ratio=0.0), rigid, body):
        assert viscous(link) is link
    assert everything(Arm(links=(DAMPED, body)), 2, 1) == ((2, 2, 0), (0, 0, 0))
