"""Arms described anew with values of free parameters, against compiled code that takes them."""

from dataclasses import replace

import numpy as np
import pytest

from dynamics import Arm, Body, Joint, Link, Mode, Payload, Section, Stepper, compile_arm
from dynamics.description.parameters import with_parameters
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.formulations.gibbs_appell import mass_matrix
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.linearized import damping, friction, stiffness
from dynamics.model import Model
from dynamics.types import Array

VALUES = {
    "stiffness": 1.7, "damping": 0.6, "friction": 1.4, "payload_mass": 0.3,
    "viscous_1": 0.05, "coulomb_2": 0.02,
}  # fmt: skip


def bending(kind: str, count: int = 2) -> tuple[Mode, ...]:
    return tuple(Mode(kind=kind, index=k + 1, direction="y") for k in range(count))


ARM = Arm(
    links=(
        Link(length=0.6, rho_A=0.4, EIz=9.0, damping_ratio=0.02, modes=bending("clamped-tip-mass"),
             tip_mass=0.2, joint=Joint(rotor_inertia=0.02, viscous=0.1, coulomb=0.03)),
        Link(length=0.4, rho_A=0.2, EIz=4.0, damping_ratio=0.03, modes=bending("hierarchical"),
             segments=2, body=Body(mass=0.1), joint=Joint(
                 rotor_inertia=0.01, stiffness=30.0, spring_damping=0.02, viscous=0.05,
                 rotation={"rpy": [0.4, 0.0, 0.2]})),  # type: ignore[arg-type]
        Link(sections=(Section(length=0.2, rho_A=0.2, EIz=(3.0, 2.0)),
                       Section(length=0.1, rho_A=0.1, EIz=1.0)),
             damping_beta=1e-3, modes=bending("clamped-free"), joint=Joint(rotor_inertia=0.01)),
    ),
    payload=Payload(mass=0.1, com=(0.05, 0.0, 0.0)),
    gravity=(0.0, -9.81, 1.0),
)  # fmt: skip


def test_an_arm_described_anew_has_the_matrices_of_the_chain_with_the_parameters() -> None:
    """Of a damping of 0.6, for one: every coefficient, of springs too, is 0.6 times as large."""

    def inertia(chain: Chain) -> Array:
        return np.array(mass_matrix(chain, [0.1] * ARM.n))

    for name, value in VALUES.items():
        described = Model(with_parameters(ARM, {name: value})).chain
        applied = FREE_PARAMETERS[name].apply(Model(ARM).chain, value)
        for matrix in (stiffness, damping, friction, inertia):
            expected = matrix(applied)
            size = np.abs(expected).max()
            np.testing.assert_allclose(matrix(described), expected, rtol=0.0, atol=1e-9 * size)
    plain, scaled = (Model(with_parameters(ARM, {"damping": x})).chain for x in (1.0, 0.6))
    modal = np.ix_(*[[k for k in range(ARM.n) if k not in ARM.joint_index]] * 2)
    np.testing.assert_allclose(damping(scaled)[modal], 0.6 * damping(plain)[modal], rtol=1e-9)


@pytest.mark.compiles
@pytest.mark.parametrize(
    "names", [list(VALUES), *[[name] for name in VALUES]], ids=["all", *VALUES]
)
def test_an_arm_described_anew_moves_as_the_compiled_one_with_the_parameters(
    names: list[str],
) -> None:
    values = {name: VALUES[name] for name in names}
    free = compile_arm(ARM, free_parameters=names)
    described = compile_arm(with_parameters(ARM, values))
    rng = np.random.default_rng(0)
    q, v = 0.02 * rng.normal(size=(2, ARM.n))
    moved = []
    for model in (free, described):
        stepper = Stepper(model, 1, dt=1e-4, substeps=1)
        stepper.parameters[:] = [values[name] for name in model.free_parameters]
        stepper.q[:], stepper.v[:], stepper.torque[:] = q, v, [0.3, -0.2, 0.1]
        stepper.advance()
        moved.append(np.concatenate([stepper.q[0], stepper.v[0]]))
    np.testing.assert_allclose(moved[1], moved[0], rtol=1e-9, atol=1e-12)
    still = Stepper(compile_arm(ARM), 1, dt=1e-4, substeps=1)
    still.q[:], still.v[:], still.torque[:] = q, v, [0.3, -0.2, 0.1]
    still.advance()
    assert not np.allclose(still.v[0], moved[0][ARM.n :], rtol=1e-9)


def test_nominal_values_change_nothing() -> None:
    assert with_parameters(ARM, {}) == ARM
    nominal = {"stiffness": 1.0, "damping": 1.0, "payload_mass": 0.0, "viscous_1": 0.0}
    assert with_parameters(ARM, nominal) == ARM
    bare = replace(ARM, payload=None)
    assert with_parameters(bare, {"payload_mass": 0.2}).payload == Payload(mass=0.2)


@pytest.mark.parametrize("name", FREE_PARAMETERS)
def test_a_free_parameter_is_one_that_the_arm_has(name: str) -> None:
    """Friction of a joint that the arm has not is refused when the arm is compiled."""
    joint = int(name.rsplit("_", 1)[1]) if name[-1].isdigit() else 1
    if joint <= ARM.n_joint:
        assert compile_arm(ARM, free_parameters=[name]).free_parameters == (name,)
        return
    with pytest.raises(ValueError, match=f"{name} is of no joint: this arm has 3 joints"):
        compile_arm(ARM, free_parameters=[name])
