"""Every formulation through the interface of Model: compiled, evaluated, linearised, refused."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ARMS, Arm, Joint, Model, Stepper, compile_arm
from dynamics.backends.numba_llvm.stepper_entries import LANES
from dynamics.description.arm import FOURTH_ORDER
from dynamics.formulations import table
from dynamics.formulations.table import FORMULATIONS
from dynamics.types import Array
from tests.dynamics.agreement import assert_compiled, assert_slopes, central
from tests.dynamics.random_arms import (
    compiled,
    floats,
    random_arm,
    random_state,
    random_torque,
    two_link_spatial,
)

ARM = two_link_spatial()
SMALL = random_arm(18, 1, 2)
SIBLINGS = [name for name in FORMULATIONS if name != "gibbs_appell"]


@pytest.fixture(params=FORMULATIONS, scope="module")
def model(request: pytest.FixtureRequest) -> Model:
    return compile_arm(ARM, formulation=request.param)


@pytest.mark.parametrize(("arm", "lanes"), [(SMALL, LANES), (ARM, 1)], ids=["many", "one"])
@pytest.mark.parametrize("name", FORMULATIONS)
def test_compiled_code_is_the_formulation_on_floats(arm: Arm, name: str, lanes: int) -> None:
    """Compared in every lane, including a partly filled block."""
    model = compile_arm(arm, formulation=name)

    def expected(q: Array, v: Array, tau: Array) -> Array:
        x = floats(q), floats(v), floats(tau)
        return np.array(FORMULATIONS[name].accelerations(model.chain, *x))

    assert_compiled(model, lanes, 1e-12, expected)


def test_questions_of_inertia_and_forces_fit_together(model: Model) -> None:
    """M a + h = B tau, T = 1/2 v' M v, graph and code agree, K is the Hessian of the energy."""
    (q, v), tau = random_state(ARM), random_torque(ARM)
    M, h, a = model.mass_matrix(q), model.bias(q, v), model.accelerations(q, v, tau)

    drive = np.zeros(ARM.n)
    drive[list(ARM.joint_index)] = tau
    assert_allclose(model.inverse_dynamics(q, v, a), drive, atol=1e-10 * np.abs(h).max())
    many = [np.outer(np.linspace(-1.0, 1.0, LANES + 3), x) for x in (q, v, v)]
    each = [model.inverse_dynamics(*state) for state in zip(*many, strict=True)]
    assert_allclose(model.inverse_dynamics(*many), each, atol=1e-12 * np.abs(h).max())
    kinetic, elastic, _ = model.energy(q, v)
    assert kinetic == pytest.approx(0.5 * v @ M @ v, rel=1e-12)
    assert elastic == pytest.approx(0.5 * q @ model.stiffness @ q, rel=1e-12)
    assert_allclose(np.array(model.graph(q, v, tau, [], [])).ravel(), a, rtol=1e-10)
    counts = model.operation_count()
    assert counts["accelerations"]["divisions"] == ARM.n
    assert counts["mass matrix and bias"]["divisions"] == 0


def test_questions_of_vibration_do_not_depend_on_the_formulation(model: Model) -> None:
    recursion = compiled(ARM)
    q, _ = random_state(ARM)

    for joints in ("locked", "free"):
        expected = recursion.frequencies(q, joints=joints)
        assert_allclose(model.frequencies(q, joints=joints), expected, rtol=1e-10)
    assert_allclose(model.strain(q, 0, 0.3), recursion.strain(q, 0, 0.3), rtol=1e-14)


def test_linearisation_is_the_slope_of_the_accelerations(model: Model) -> None:
    (q, v), tau = random_state(ARM), random_torque(ARM)

    A, B = model.linearize(q, v, tau)

    assert B.shape == (2 * ARM.n, ARM.n_joint)
    assert_slopes(model, A, q, v, tau)


@pytest.mark.parametrize("rotation", ["exp", "linear"])
@pytest.mark.parametrize("name", ["gibbs_appell", "book"])
def test_tip_velocity_is_the_rate_of_the_tip(name: str, rotation: str) -> None:
    """It is not with theta_dot as the rate of 1 + theta~; it is with Book's E_dot."""
    model = compile_arm(replace(ARM, rotation=rotation), formulation=name)
    q, v = random_state(ARM)

    moved = central(lambda t: model.tip(q + t * v), 1e-4)

    error = np.abs(model.tip_velocity(q, v) - moved).max()
    if (name, rotation) == ("gibbs_appell", "linear"):
        assert error > 1e-3
    else:
        assert error < 1e-8


@pytest.mark.parametrize("name", SIBLINGS)
def test_implicit_steps_are_those_of_the_recursion(name: str) -> None:
    """A hundred steps of a batch with implicit elastic and damping forces."""
    ends = []
    for formulation in (name, "gibbs_appell"):
        model = compile_arm(SMALL, formulation=formulation)
        stepper = Stepper(model, 2, dt=1e-3, substeps=100, integrator="midpoint")
        for row, seed in enumerate((0, 1)):
            stepper.q[row] = random_state(SMALL, seed)[0]
        stepper.torque[:] = 0.5
        stepper.advance()
        ends.append((stepper.q.copy(), stepper.v.copy()))

    assert np.abs(ends[1][1]).max() > 0.1
    assert_allclose(ends[0][0], ends[1][0], rtol=0.0, atol=1e-10)
    assert_allclose(ends[0][1], ends[1][1], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("name", SIBLINGS)
def test_a_free_parameter_reaches_every_formulation(name: str) -> None:
    free = ("payload_mass", "stiffness", "friction")
    (q, v), tau = random_state(ARM), random_torque(ARM)
    mine, theirs = (
        np.array(compile_arm(ARM, formulation=x, free_parameters=free).graph(q, v, tau, p, []))
        for x in (name, "gibbs_appell")
        for p in [[0.7, 1.3, 0.5]]
    )

    assert_allclose(mine, theirs, rtol=1e-10)
    assert np.abs(mine.ravel() - compiled(ARM).accelerations(q, v, tau)).max() > 0.1


@pytest.mark.parametrize("name", FORMULATIONS)
def test_every_preset_has_the_same_mass_matrix_or_a_refusal(name: str) -> None:
    """Only gibbs_appell supports prismatic joints, joint springs, parallel drives, other bases.

    Nor do others foreshorten to fourth order: such presets are compared with true.
    """
    exact = {preset for preset, arm in ARMS.items() if arm.foreshortening == FOURTH_ORDER}
    assert exact
    for preset in exact:
        assert bool(table.why_not(ARMS[preset], name)) == (name != "gibbs_appell")
    arms = {k: replace(arm, foreshortening=bool(arm.foreshortening)) for k, arm in ARMS.items()}
    refused = {preset for preset, arm in arms.items() if table.why_not(arm, name)}
    others = {"stanford", "srms-like", "ralf-like", "free-flyer"}
    assert refused == (set() if name == "gibbs_appell" else others)
    for preset in sorted(set(arms) - refused):
        chain, q = compiled(arms[preset]).chain, floats(random_state(arms[preset])[0])
        M, expected = (
            np.array(FORMULATIONS[x].equations.mass_matrix(chain, q))
            for x in (name, "gibbs_appell")
        )
        assert_allclose(M, expected, rtol=0.0, atol=1e-12 * np.abs(M).max())
    for preset in refused:
        with pytest.raises(ValueError, match=r"does not support (Joint|Base)\.\w+, got"):
            compile_arm(arms[preset], formulation=name)


def test_a_model_remembers_its_formulation(model: Model) -> None:
    copy = pickle.loads(pickle.dumps(model))
    assert copy.formulation == model.formulation
    assert copy.program(1, "rk4") is model.program(1, "rk4")


def test_formulations_have_programs_of_their_own() -> None:
    files = [compile_arm(SMALL, formulation=x).program(1, "rk4").__file__ for x in FORMULATIONS]
    assert len(set(files)) == len(FORMULATIONS)


@pytest.mark.parametrize("name", SIBLINGS)
def test_a_sibling_refuses_what_it_does_not_know(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message names formulation, field and value; gibbs_appell supports every field."""
    known = {**table.FIXED_BASE_AND_REVOLUTE, "Joint": frozenset({"rotation", "offset"})}
    poorer = {name: replace(FORMULATIONS[name], supported=known)}
    monkeypatch.setattr(table, "FORMULATIONS", {**FORMULATIONS, **poorer})
    arm = replace(ARM, links=(replace(ARM.links[0], joint=Joint(viscous=0.2)), ARM.links[1]))

    refusal = rf"'{name}' does not support Joint.viscous, got 0.2; .*use"
    with pytest.raises(ValueError, match=refusal):
        compile_arm(arm, formulation=name)
    assert compile_arm(arm).formulation == "gibbs_appell"


def test_an_unknown_formulation_is_refused_with_those_that_exist() -> None:
    with pytest.raises(ValueError, match=r"Unknown formulation 'newton'. Known: \['book', "):
        compile_arm(ARM, formulation="newton")
