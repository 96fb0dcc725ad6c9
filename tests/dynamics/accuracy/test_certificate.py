"""Certificates: many steps from one reference, and refusals."""

from dataclasses import replace

import pytest

from dynamics import Arm, Joint, Link, Mode
from dynamics.accuracy.certificate import Certifier, certify
from dynamics.accuracy.scene import Scene, bang_bang

LINK = Link(
    length=1.0, rho_A=0.3, EIz=12.0, tip_mass=0.2, damping_ratio=0.02,
    modes=tuple(Mode(kind="clamped-tip-mass", index=k, direction="y") for k in (1, 2)),
    joint=Joint(rotor_inertia=0.1),
)  # fmt: skip
ARM = Arm(links=(LINK,), foreshortening=True)
SCENE = Scene(name="slew", motions=(replace(bang_bang((0.6,), pulse=0.2, t_end=0.8), hold=0.02),))


def test_all_steps_share_a_reference_and_err_as_certified_alone() -> None:
    certifier = Certifier(ARM, SCENE, 1e-4)
    for integrator, substeps in (("rk4", 2), ("numerov", 4)):
        dt = 0.02 / substeps
        alone = certify(ARM, SCENE, integrator, dt, 1e-4)
        assert certifier.certificate(integrator, dt) == alone
        assert certifier.error(integrator, dt) == alone.error
        assert abs(alone.error - alone.integration) <= certifier.model_error


def test_a_step_that_does_not_divide_the_hold_is_refused() -> None:
    with pytest.raises(ValueError, match=r"dt \(0.003 s\) must divide JointMotion.hold \(0.02 s\)"):
        certify(ARM, SCENE, "rk4", 0.003, 1e-4)
