"""The stability limit of a step, from the linearised arm and in motion."""

import numpy as np
import pytest

from dynamics import Joint, Link, Mode, Stepper, simulate
from dynamics.description.arm import Arm
from dynamics.formulations.linearized import LinearArm
from dynamics.simulation.step_limits import GROWS, amplification, largest_step
from tests.dynamics.random_arms import compiled

SEGMENTS = Arm(
    links=(
        Link(
            length=0.6, rho_A=0.3, EIz=60.0, tip_mass=0.4, damping_ratio=0.3, segments=2,
            modes=tuple(Mode(kind="hierarchical", index=k, direction="y") for k in (1, 2)),
            joint=Joint(rotor_inertia=1e-3),
        ),
    ),
    name="damped segments",
)  # fmt: skip


@pytest.mark.parametrize("integrator", ["midpoint", "extrapolated-midpoint", "generalized-alpha"])
def test_damping_across_segments_breaks_implicit_methods_where_the_limit_says(
    integrator: str,
) -> None:
    """It couples bodies, so they take it explicitly."""
    model = compiled(SEGMENTS)
    limit = largest_step(model, np.zeros(model.n), integrator, 1.0)
    ends = []
    for share in (0.97, 1.03):
        stepper = Stepper(model, 1, dt=share * limit, substeps=2000, integrator=integrator)
        stepper.q[0, 1:] = 1e-9
        stepper.advance()
        ends.append(stepper.status[0] == 0 and np.abs(stepper.q[0, 1:]).max() < 1e-6)
    assert ends == [True, False]
    still = np.zeros(model.n)
    with pytest.raises(ValueError, match="smaller dt, or a method with error control"):
        simulate(model, still, still, None, [0, 1], integrator=integrator, dt=1.03 * limit)


@pytest.mark.parametrize(
    ("integrator", "limit"),
    [("midpoint", 1.0), ("generalized-alpha", 1.0), ("extrapolated-midpoint", 0.5),
     ("numerov", 0.16)],
)  # fmt: skip
def test_explicit_damping_limits_the_steps_of_implicit_methods_as_documented(
    integrator: str, limit: float
) -> None:
    """Step times decay, in docs/stability.md."""
    none, never = np.zeros((1, 1)), np.full(1, np.inf)
    for share, stable in ((0.97, True), (1.03, False)):
        arm = LinearArm(np.eye(1), none, none, share * limit * np.eye(1), lambda kind: never)
        assert (amplification(arm, integrator, 1.0) < 1.0 + GROWS) == stable
