"""Simulate one arm, by SciPy's methods with error control or by fixed steps."""

import warnings
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import BDF, DOP853, OdeSolver, Radau

from dynamics.description import validate
from dynamics.integrators.table import INTEGRATORS
from dynamics.model import Model
from dynamics.simulation import quaternion_state, step_limits
from dynamics.simulation.case_file import jump_times
from dynamics.simulation.stepper import Stepper
from dynamics.simulation.trajectory import Trajectory
from dynamics.simulation.validity import FARTHEST, limits
from dynamics.types import Array, TorqueSignal
from dynamics.validity import ValidityWarning

Signal = Callable[[float], Array]  # a torque signal whose values are validated

REFERENCES = {"dop853": DOP853, "radau": Radau, "bdf": BDF}
RTOL = 1e-10  # default of the methods with error control
FINEST = 3e-14  # the smallest that SciPy's methods take
STEP_TIMES_RATE = 0.1  # default dt of a fixed-step method times the fastest rate of the arm
MOST_STEPS = 1e9  # of a fixed-step method: hours
TRY_RADAU = 100_000  # evaluations of DOP853 (a few seconds) above which "auto" tries Radau's method
TRIAL = 8000  # evaluations that compare the two: decaying starts are slow for both
RADAU_COST = 4.0  # of its evaluation, Jacobians and linear algebra included, over DOP853's


class Diverged(RuntimeError):
    """A simulation became non-finite or exceeded the largest meaningful state."""


def simulate(
    model: Model,
    q: ArrayLike,
    v: ArrayLike,
    torque: TorqueSignal | ArrayLike | None,
    times: ArrayLike,
    *,
    integrator: str = "auto",
    dt: float | None = None,
    rtol: float | None = None,
) -> Trajectory:
    """Integrate the equations of motion from (q, v) at `times[0]`.

    Parameters
    ----------
    model : the compiled arm.
    q, v : (n,) initial state. The coordinates of a free base may be left out; it then starts
        in the state that `Base` describes.
    torque : (n_torque,) [N m] constant torques, a function of time, or None. A function may list
        the times of its jumps in an attribute `breakpoints`.
    times : (N,) [s] increasing output times.
    integrator : one of SciPy's methods with error control, "dop853" (explicit), "radau" or "bdf"
        (implicit, with exact Jacobians); "auto", the cheaper of "dop853" and "radau"; or a
        fixed-step method of INTEGRATORS, each step of which takes the torque at its midpoint. At
        equal tolerance BDF's error is at least ten times the others'.
    dt : [s] largest step of a fixed-step method; default 0.1 over the fastest frequency or decay.
    rtol : relative tolerance of error control, 3e-14 to below 1; default 1e-10.

    Warns
    -----
    ValidityWarning : for each assumption of the model that is violated at an output time, see
        `dynamics.limits`.

    Raises
    ------
    Diverged : with the time and a remedy.
    ValueError : for arguments of wrong size, a start beyond the largest meaningful state, or a
        step beyond the method's stability limit.
    """
    base = validate.instance(model, "model", Model).arm.base
    start = (_state(model, q, base.q, "q"), _state(model, v, base.v, "v"))
    grid = validate.array(times, "times", (None,))
    if grid.size < 1 or np.any(np.diff(grid) <= 0.0):
        raise ValueError(
            f"times must be at least one number and strictly increasing, got {grid.size} numbers."
        )
    validate.known(integrator, "integrator", ["auto", *REFERENCES, *INTEGRATORS])
    signal, jumps = _signal(model, torque)
    if integrator not in INTEGRATORS:
        if dt is not None:
            raise ValueError(
                f"dt ({validate.shown(dt)} s) is for fixed-step methods; give {integrator} an rtol."
            )
        accuracy = RTOL if rtol is None else validate.number(rtol, "rtol", "-")
        if not FINEST <= accuracy < 1.0:
            raise ValueError(f"rtol must be at least {FINEST:g} and below 1, got {accuracy!r}.")
        motion = _ErrorControlled(model, start, signal, jumps, grid, accuracy)
        integrator = motion.cheapest() if integrator == "auto" else integrator
        states = motion.solve(integrator)
    else:
        if rtol is not None:
            raise ValueError(
                f"rtol ({validate.shown(rtol)}) is for error control; give {integrator} a dt."
            )
        states = _fixed_steps(model, start, signal, jumps, grid, integrator, dt)
    rates = states[:, model.n :]
    positions = states[:, : model.n]
    measured = np.empty((grid.size, model.n_measure))
    Stepper(model, 1, dt=1.0, substeps=1).measure(positions.copy(), rates.copy(), measured)
    poses = quaternion_state.in_space(positions, base)
    place = poses[:, :3].copy() if base.n else None
    attitude = quaternion_state.quaternions(poses, base.quaternion) if base.n else None
    tip = measured[:, model.measurements["tip"]].copy()
    trajectory = Trajectory(grid, positions, rates, tip, place, attitude, integrator)
    for sentence in limits(model, trajectory):
        warnings.warn(sentence, ValidityWarning, stacklevel=2)
    return trajectory


def _state(model: Model, x: ArrayLike, base: tuple[float, ...], name: str) -> Array:
    array = validate.array(x, name, (None,))
    if array.shape == (model.n - len(base),):
        array = np.concatenate([base, array])
    array = validate.array(array, name, (model.n,))
    for k in np.flatnonzero(np.abs(array) > FARTHEST):
        raise ValueError(
            f"{name}[{k}] must be at most {FARTHEST:g} in size, or a motion diverges at once, got "
            f"{array[k]:g}; start nearer, an angle without its whole turns."
        )
    return array


def _signal(
    model: Model, torque: TorqueSignal | ArrayLike | None
) -> tuple[Signal | Array, list[float]]:
    """Torque as a function or a constant, and the increasing times [s] of its jumps."""
    if torque is None:
        return np.zeros(model.n_torque), []
    numbers = partial(validate.array, shape=(model.n_torque,))
    if not callable(torque):
        return numbers(torque, "torque"), []

    def checked(t: float) -> Array:
        return numbers(torque(t), f"torque({t:.6g} s)")

    return checked, list(jump_times(torque))


class _ErrorControlled:
    """A motion by SciPy's methods with error control.

    They integrate the attitude of a free base as a quaternion: see quaternion_state.py.
    """

    def __init__(
        self,
        model: Model,
        start: tuple[Array, Array],
        signal: Signal | Array,
        jumps: list[float],
        times: Array,
        rtol: float,
    ) -> None:
        self.model, self.signal, self.times, self.rtol = model, signal, times, rtol
        q = quaternion_state.with_quaternion(start[0]) if model.arm.base.spatial else start[0]
        self.start = np.concatenate([q, start[1]])
        between = [t for t in jumps if times[0] < t < times[-1]]
        self.knots = [float(times[0]), *between, float(times[-1])]
        self._program = model.program(1, "rk4")
        self._w, self._out = model.workspace(self._program), np.empty((1, model.n))

    def _torque(self, t: float, begin: float, end: float) -> Array:
        """Torque at t between two jumps; at `end`, the value before the jump."""
        if not callable(self.signal):
            return self.signal
        return self.signal(min(max(t, begin), np.nextafter(end, begin)))

    def solver(self, name: str, x: Array, begin: float, end: float) -> OdeSolver:
        """SciPy's solver from state x at `begin` to the next jump at `end`."""
        n, parameters = self.model.n, self.model.nominal_parameters[None]
        free = self.model.arm.base.spatial

        def derivative(t: float, x: Array) -> Array:
            tau = self._torque(t, begin, end)[None]
            q, v = (quaternion_state.with_rotation_vector(x[:-n]) if free else x[:n]), x[-n:]
            self._program.evaluate_states(q[None], v[None], tau, parameters, self._w, self._out)
            return np.concatenate([quaternion_state.rates(x[:-n], v) if free else v, self._out[0]])

        def jacobian(t: float, x: Array) -> Array:
            return self.model.linearize(x[:n], x[n:], self._torque(t, begin, end))[0]

        # with a free base SciPy takes the Jacobian by differences
        options = {} if name == "dop853" or free else {"jac": jacobian}
        return REFERENCES[name](
            derivative, begin, x, end, rtol=self.rtol, atol=1e-2 * self.rtol, **options
        )

    @np.errstate(over="ignore", invalid="ignore")  # a solver retries a non-finite step, or fails
    def solve(self, name: str) -> Array:
        """(N, 2 n) states at the output times, from the solver's dense output."""
        rows, n = self._rows(name), self.model.n
        if not self.model.arm.base.spatial:
            return rows
        positions = [quaternion_state.with_rotation_vector(x) for x in rows[:, :-n]]
        return np.hstack([positions, rows[:, -n:]])

    def _rows(self, name: str) -> Array:
        """Solver states at the output times, a free base's attitude as a quaternion."""
        rows = np.empty((self.times.size, self.start.size))
        rows[0] = x = self.start
        done = 1
        for begin, end in pairwise(self.knots):
            solver = self.solver(name, x, begin, end)
            while solver.status == "running":
                try:
                    solver.step()
                except ValueError:  # SciPy refuses a matrix that is not finite
                    raise _diverged(solver.t) from None
                if solver.status == "failed" or np.abs(solver.y).max() > FARTHEST:
                    raise _diverged(solver.t)
                stop = int(np.searchsorted(self.times, solver.t, side="right"))
                if stop > done:
                    rows[done:stop] = solver.dense_output()(self.times[done:stop]).T
                    done = stop
            x = solver.y
        return rows

    def cheapest(self) -> str:
        """DOP853, unless the motion is long and Radau's method costs less at its start."""
        explicit = self._evaluations_per_second("dop853")
        if not explicit * (self.knots[-1] - self.knots[0]) > TRY_RADAU:
            return "dop853"
        implicit = RADAU_COST * self._evaluations_per_second("radau")
        return "radau" if implicit < explicit else "dop853"

    @np.errstate(over="ignore", invalid="ignore")
    def _evaluations_per_second(self, name: str) -> float:
        """Evaluations per second of motion, over the first TRIAL evaluations."""
        solver = self.solver(name, self.start, self.knots[0], self.knots[1])
        while solver.status == "running" and solver.nfev < TRIAL:
            try:
                solver.step()
            except ValueError:  # SciPy refuses a matrix that is not finite
                return float("inf")
        return float(solver.nfev / max(solver.t - self.knots[0], np.finfo(float).tiny))


def _fixed_steps(
    model: Model,
    start: tuple[Array, Array],
    signal: Signal | Array,
    jumps: list[float],
    times: Array,
    integrator: str,
    dt: float | None,
) -> Array:
    """(N, 2 n) states at `times`, by equal steps of at most `dt` between output times and jumps."""
    fastest = step_limits.fastest(model, start[0])
    duration = float(np.ptp(times))
    if dt is not None:
        largest = validate.positive(dt, "dt", "s")
    else:
        largest = STEP_TIMES_RATE / fastest if fastest else duration / 1000.0 or 1.0
    if duration > MOST_STEPS * largest:
        raise ValueError(
            f"dt must be at least {duration / MOST_STEPS:.3g} s, so that {duration:.6g} s take at "
            f"most {MOST_STEPS:g} steps, got {largest:.3g} s. Take a larger dt, a shorter motion "
            "or a method with error control."
        )
    limit = step_limits.largest_step(model, start[0], integrator, largest)
    if limit < largest:
        implicit = INTEGRATORS[integrator].implicit
        other = "'midpoint', which takes elastic forces implicitly"
        raise ValueError(
            f"dt must be at most {limit:.3g} s, or {integrator} diverges from rest (fastest "
            f"frequency or decay {fastest:.4g} rad/s), got {dt!r} s. Take a smaller dt, or "
            f"{'a method with error control' if implicit else other}."
        )
    stepper = Stepper(model, 1, dt=largest, substeps=1, integrator=integrator)
    stepper.q[0], stepper.v[0] = start
    rows = np.empty((times.size, 2 * model.n))
    rows[0] = np.concatenate(start)
    for k, (begin, end) in enumerate(pairwise(times), 1):
        knots = [begin, *(t for t in jumps if begin < t < end), end]
        for left, right in pairwise(knots):
            _march(stepper, signal, left, right, largest)
        rows[k, : model.n], rows[k, model.n :] = stepper.q[0], stepper.v[0]
    return rows


def _march(
    stepper: Stepper, signal: Signal | Array, begin: float, end: float, largest: float
) -> None:
    """Take equal steps from `begin` to `end`; under a constant torque one call takes them all."""
    steps = max(1, int(np.ceil((end - begin) / largest - 1e-9)))
    stepper.dt = (end - begin) / steps
    calls = steps if callable(signal) else 1
    stepper.substeps = steps // calls
    for k in range(calls):
        middle = begin + (k + 0.5) * stepper.dt
        stepper.torque[0] = signal(middle) if callable(signal) else signal
        stepper.advance()
        if stepper.status[0]:
            raise _diverged(begin + (k + int(stepper.status[0])) * stepper.dt)
        if max(np.abs(stepper.q).max(), np.abs(stepper.v).max()) > FARTHEST:
            raise _diverged(begin + (k + 1) * stepper.substeps * stepper.dt)


def _diverged(t: float) -> Diverged:
    return Diverged(
        f"The simulation diverged at t = {t:.6g} s; take a smaller dt or torque, or a stiffer arm."
    )
