"""Environments of a batch move independently of each other, of threads and of lanes."""

import itertools
import math
import pickle
import re
import threading
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from dynamics import Arm, Joint, Model, Payload, Stepper, compile_arm
from dynamics.backends.numba_llvm.stepper_entries import LANES
from dynamics.description.deflection import curvature
from dynamics.integrators.table import INTEGRATORS
from dynamics.runtime import thread_pool
from tests.dynamics.random_arms import (
    compiled,
    random_state,
    random_torque,
    two_link_spatial,
)

OBLIQUE = Joint(rotation=((1.0, 0.0, 0.0), (0.0, 0.8, -0.6), (0.0, 0.6, 0.8)), rotor_inertia=0.05)
SPATIAL = two_link_spatial()
LINK = replace(SPATIAL.links[0], joint=OBLIQUE)  # bends in both planes and twists
ARM = Arm(links=(LINK,), gravity=(0.0, 0.0, -9.81), name="spatial link")
FREE = ("payload_mass", "stiffness", "damping", "friction")


def batch(
    model: Model, count: int, *, integrator: str = "rk4", threads: int = 1, first: int = 0
) -> Stepper:
    """A batch of random states and torques; environment k has the seed `first` + k."""
    stepper = Stepper(model, count, dt=1e-4, substeps=5, integrator=integrator, threads=threads)
    for k in range(count):
        stepper.q[k], stepper.v[k] = random_state(model.arm, first + k)
        stepper.torque[k] = random_torque(model.arm, first + k)
    return stepper


def results(stepper: Stepper, times: int = 2) -> np.ndarray:
    """State and measurements after a few calls."""
    for _ in range(times):
        stepper.advance()
    assert not stepper.status.any()
    return np.hstack([stepper.q, stepper.v, stepper.measured])


# Rosenbrock's Jacobian takes long to compile: test_integrators.py has it.
@pytest.fixture(scope="module", params=sorted(set(INTEGRATORS) - {"rosenbrock"}))
def integrator(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def hundred(integrator: str) -> np.ndarray:
    return results(batch(compiled(ARM), 100, integrator=integrator))


@pytest.mark.parametrize("count", [2, LANES, LANES + 1])
def test_an_environment_does_not_depend_on_the_size_of_its_batch(
    hundred: np.ndarray, integrator: str, count: int
) -> None:
    """Bit for bit."""
    assert np.array_equal(
        results(batch(compiled(ARM), count, integrator=integrator)), hundred[:count]
    )


@pytest.mark.parametrize("count", [1, 2 * LANES, 100])
def test_float32_is_float64_to_single_precision(
    hundred: np.ndarray, integrator: str, count: int
) -> None:
    """Ten steps; and different, so that the code really is single precision."""
    single = results(batch(compile_arm(ARM, dtype="float32"), count, integrator=integrator))

    error = np.abs(single - hundred[:count]) / np.abs(hundred).max(axis=0)
    assert 1e-10 < error.max() < 2e-5


@pytest.mark.parametrize("threads", [2, 3, 64])
def test_an_environment_does_not_depend_on_threads(
    hundred: np.ndarray, integrator: str, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit for bit, also with more threads than blocks."""
    monkeypatch.setattr(thread_pool, "LEAST_WORK", 1e-9)  # else one thread would step this batch
    stepper = batch(compiled(ARM), 100, integrator=integrator, threads=threads)
    assert stepper.threads == min(threads, math.ceil(100 / LANES))
    assert np.array_equal(results(stepper), hundred)


def test_the_number_of_threads_grows_with_the_work_of_a_call() -> None:
    """Work is the batch size times the substeps times the evaluations per step."""
    least = next(n for n in itertools.count(1) if threads_of(n) > 1)

    assert LANES < least < 10_000
    assert threads_of(100 * least) == 4
    assert threads_of(math.ceil(least / 4), substeps=4) > 1
    assert threads_of(math.ceil(least / 4), integrator="rk4") > 1


def threads_of(n_env: int, substeps: int = 1, integrator: str = "euler") -> int:
    model = compiled(ARM)
    stepper = Stepper(model, n_env, dt=1e-4, substeps=substeps, integrator=integrator, threads=4)
    return stepper.threads


@pytest.mark.parametrize("shift", [1, 7, LANES])
def test_an_environment_does_not_depend_on_its_lane(
    hundred: np.ndarray, integrator: str, shift: int
) -> None:
    """Bit for bit."""
    stepper = batch(compiled(ARM), 100 - shift, integrator=integrator, first=shift)
    assert np.array_equal(results(stepper), hundred[shift:])


def test_a_single_environment_equals_the_batch_to_round_off(
    hundred: np.ndarray, integrator: str
) -> None:
    single = results(batch(compiled(ARM), 1, integrator=integrator))
    assert_allclose(single[0], hundred[0], rtol=1e-11, atol=1e-13)


def test_several_calls_of_few_substeps_equal_one_call_of_many() -> None:
    """With rk4, which keeps nothing between steps."""
    few, many = batch(compiled(ARM), 3), batch(compiled(ARM), 3)
    many.substeps = 20

    assert np.array_equal(results(few, 4), results(many, 1))


def soft(count: int) -> Stepper:
    """A batch of environments with almost no stiffness."""
    stepper = batch(compiled(ARM, *FREE), count)
    stepper.parameters[:, FREE.index("stiffness")] = 1e-6
    return stepper


@pytest.mark.parametrize("count", [1, LANES, LANES + 3])
def test_a_diverged_environment_keeps_its_state_and_disturbs_no_other(count: int) -> None:
    """Under a huge torque; after it, the environment continues as if it had not diverged."""
    calm, wild = soft(count), soft(count)
    before = wild.q[-1].copy(), wild.v[-1].copy(), wild.measured[-1].copy()
    wild.torque[-1] = 1e150

    calm.advance()
    wild.advance()

    assert 1 <= wild.status[-1] <= wild.substeps
    for kept, was in zip((wild.q[-1], wild.v[-1], wild.measured[-1]), before, strict=True):
        assert np.array_equal(kept, was)
        assert np.all(np.isfinite(kept))
    assert not wild.status[:-1].any()
    for name in ("q", "v", "measured"):
        assert np.array_equal(getattr(wild, name)[:-1], getattr(calm, name)[:-1])

    wild.torque[-1] = calm.torque[-1]
    wild.advance()
    assert wild.status[-1] == 0
    assert np.array_equal(wild.q[-1], calm.q[-1])


def test_status_is_the_substep_of_the_divergence() -> None:
    """With any number of substeps per call; the substep before is still finite."""

    def status(substeps: int) -> int:
        stepper = batch(compiled(ARM, *FREE), 2)
        stepper.parameters[0, FREE.index("stiffness")] = 1e5  # too stiff for the step
        stepper.substeps = substeps
        stepper.advance()
        return int(stepper.status[0])

    failed = status(100)

    assert failed > 1
    assert status(failed) == status(failed + 1) == failed
    assert status(failed - 1) == 0


def test_a_state_that_is_not_finite_is_reported_at_the_first_substep() -> None:
    for value in (np.nan, np.inf):
        for name in ("q", "v", "torque"):
            stepper = batch(compiled(ARM), 2)
            getattr(stepper, name)[1, 0] = value
            stepper.advance()
            assert stepper.status.tolist() == [0, 1], (name, value)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_stepper_may_change_its_step(integrator: str, dtype: str) -> None:
    """Values that a method prepared for the old step length are renewed."""
    model = compiled(ARM) if dtype == "float64" else compile_arm(ARM, dtype=dtype)
    stepper, fresh = (batch(model, 3, integrator=integrator) for _ in range(2))
    start = stepper.q.copy()
    stepper.advance()
    stepper.q[:], stepper.v[:] = start, 0.0
    fresh.v[:] = 0.0
    stepper.dt = fresh.dt = 0.5 * fresh.dt
    assert np.array_equal(results(stepper), results(fresh))


def changed(parameters: dict[str, float]) -> Arm:
    """The arm with the values of its free parameters in its description."""
    links = tuple(
        replace(
            k,
            EIz=k.EIz * parameters["stiffness"],
            EIy=k.EIy * parameters["stiffness"],
            GJ=k.GJ * parameters["stiffness"],
            damping_beta=k.damping_beta * parameters["damping"] / parameters["stiffness"],
            joint=replace(
                k.joint,
                viscous=k.joint.viscous * parameters["friction"],
                coulomb=k.joint.coulomb * parameters["friction"],
            ),
        )
        for k in SPATIAL.links
    )
    return replace(SPATIAL, links=links, payload=Payload(mass=parameters["payload_mass"]))


def test_free_parameters_act_like_an_arm_compiled_with_their_values(integrator: str) -> None:
    """In every lane; an exponential step, which keeps the nominal modes, to its own error."""
    model = compiled(SPATIAL, *FREE)
    stepper = batch(model, 3, integrator=integrator)
    assert stepper.parameters.tolist() == [[0.0, 1.0, 1.0, 1.0]] * 3
    stepper.parameters[1] = [0.7, 1.4, 2.0, 3.0]

    free = results(stepper)

    fixed = compile_arm(changed(dict(zip(FREE, stepper.parameters[1], strict=True))))
    same = results(batch(fixed, 1, integrator=integrator, first=1))[0]
    error = 1e-13
    if INTEGRATORS[integrator].aid == "modes":
        error = 3.0 * np.abs(same - results(batch(fixed, 1, first=1))[0]).max()
        assert error < 1e-3
    assert_allclose(free[1], same, rtol=1e-10, atol=error)
    nominal = results(batch(compiled(SPATIAL), 2, integrator=integrator))
    assert_allclose(free[0], nominal[0], rtol=1e-11, atol=1e-13)
    assert np.abs(free[1] - nominal[1]).max() > 1e-3


def test_measurements_after_a_step_are_those_of_its_end() -> None:
    stepper = batch(compiled(ARM), 3)
    stepper.advance()
    out = np.empty_like(stepper.measured)
    stepper.measure(stepper.q, stepper.v, out)

    assert np.array_equal(out, stepper.measured)


def test_measurements_equal_the_quantities_of_the_model() -> None:
    """By column name."""
    model = compiled(SPATIAL)
    stepper = batch(model, 3)
    out = np.empty_like(stepper.measured)
    stepper.measure(stepper.q, stepper.v, out)

    for q, v, row in zip(stepper.q, stepper.v, out, strict=True):
        column = {name: row[part] for name, part in model.measurements.items()}
        bent = [shift_of(model, q, i) for i in range(model.n_joint)]
        roots = [model.strain(q, i, 0.0) for i in range(model.n_joint)]
        expected = {
            "tip": model.tip(q),
            "tip_velocity": model.tip_velocity(q, v),
            "rigid_tip": model.tip(model.rigid(q)),
            "deflection": [np.linalg.norm(d) for d, _ in bent],
            "slope": [np.linalg.norm(theta) for _, theta in bent],
            "curvature": [x for root in roots for x in (root[2], root[1])],
        }
        assert column.keys() == expected.keys()
        for name, values in expected.items():
            assert_allclose(column[name], values, rtol=1e-11, atol=1e-13, err_msg=name)


def shift_of(model: Model, q: np.ndarray, i: int) -> tuple[np.ndarray, np.ndarray]:
    """Tip deflection over length, and tip rotation vector, from the link's constants."""
    link, (_, delta) = model.chain.links[i], model.chain.split(q)[i]
    return np.array(link.tip_phi).T @ delta / link.length, np.array(link.tip_theta).T @ delta


def test_curvature_columns_are_bending_along_y_and_z_at_the_root() -> None:
    model = compiled(SPATIAL)
    q = np.array([0.0, 1e-3, 2e-3, 0.0, 0.0, 3e-3, 4e-3])
    bent = [curvature(link, 0.0) for link in SPATIAL.links]
    out = np.empty((1, model.n_measure))
    Stepper(model, 2, dt=1.0, substeps=1).measure(q[None], 0.0 * q[None], out)

    (y1, z1, _), (y2, z2) = bent
    expected = [1e-3 * y1[2], 2e-3 * z1[1], 3e-3 * y2[2], 4e-3 * z2[1]]
    assert_allclose(out[0, model.measurements["curvature"]], expected, rtol=1e-12)


def test_a_pickled_model_is_the_same_model() -> None:
    model = compiled(ARM, *FREE)
    again = pickle.loads(pickle.dumps(model))

    assert again.arm == model.arm
    assert again.free_parameters == FREE
    assert again.program(LANES, "rk4") is model.program(LANES, "rk4")


BAD = [
    ({"n_env": 0}, "n_env must be between 1 and 1000000, got 0."),
    ({"n_env": 2.0}, "n_env must be an int, got 2.0."),
    ({"n_env": 10**12}, "n_env must be between 1 and 1000000, got 1000000000000."),
    ({"substeps": -1}, "substeps must be between 1 and 1000000000, got -1."),
    ({"threads": 0}, "threads must be between 1 and 1024, got 0."),
    ({"dt": 0.0}, "dt must be positive, got 0.0. Unit: [s]."),
    ({"dt": float("nan")}, "dt [s] must be a finite number, got nan."),
    ({"model": "slim"}, "model must be a Model, got 'slim'."),
    ({"integrator": "leapfrog"}, f"Unknown integrator 'leapfrog'. Known: {sorted(INTEGRATORS)}."),
]


@pytest.mark.parametrize(("change", "sentence"), BAD, ids=[s for _, s in BAD])
def test_a_bad_argument_is_refused_with_name_and_value(
    change: dict[str, object], sentence: str
) -> None:
    arguments = {"model": compiled(ARM), "n_env": 2, "dt": 1e-3, "substeps": 1} | change

    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        Stepper(**arguments)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_workspace_starts_with_a_cache_line(dtype: str) -> None:
    """At any address that the allocator returns."""
    model = compile_arm("slim", dtype=dtype)
    program = model.program(model.lanes, "rk4")
    several = [model.workspace(program) for _ in range(20)]
    assert [w.ctypes.data % 64 for w in several] == [0] * 20
    assert {(w.size, w.dtype.name) for w in several} == {(program.SLOTS * model.lanes, dtype)}


def test_a_batch_in_use_refuses_another_python_thread() -> None:
    """Four Python threads step one batch: each call completes or is refused."""
    stepper = batch(compiled(ARM), 2000)
    one = Stepper(compiled(ARM), 2000, dt=stepper.dt, substeps=stepper.substeps)
    for own, other in ((one.q, stepper.q), (one.v, stepper.v), (one.torque, stepper.torque)):
        own[:] = other
    errors: list[BaseException | None] = []
    ready = threading.Barrier(4)

    def step() -> None:
        ready.wait(10.0)
        while errors.count(None) < 5 or not (any(errors) or len(errors) > 1000):
            try:
                stepper.advance()
                errors.append(None)
            except RuntimeError as error:
                errors.append(error)

    threads = [threading.Thread(target=step) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    done = errors.count(None)
    refused = [str(error) for error in errors if error is not None]
    assert done >= 5
    assert refused, "no two calls overlapped"
    assert all("in use by another thread" in text for text in refused)
    for _ in range(done):
        one.advance()
    assert np.array_equal(stepper.q, one.q)


def test_a_batch_that_another_thread_steps_may_be_measured() -> None:
    """A workspace that both used would change the states, with status 0."""
    model = compiled(ARM)
    expected, stepper = (batch(model, 4 * LANES) for _ in range(2))
    rest, out = np.zeros_like(stepper.q), np.empty((len(stepper.q), model.n_measure))
    stepper.measure(rest, rest, out)  # compiled, as `advance` here
    for each in (expected, stepper):
        each.advance()
        each.substeps = 2000
    stepping = threading.Thread(target=stepper.advance)
    stepping.start()
    while stepping.is_alive():
        stepper.measure(rest, rest, out)
    expected.advance()
    assert_array_equal(stepper.q, expected.q)
