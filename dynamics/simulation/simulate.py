"""Follow one arm through time, by SciPy's methods with error control or by fixed steps."""

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
from dynamics.simulation.stepper import Stepper
from dynamics.simulation.trajectory import Trajectory
from dynamics.simulation.validity import FARTHEST, ValidityWarning, limits
from dynamics.types import Array

TorqueSignal = Callable[[float], ArrayLike]
Signal = Callable[[float], Array]  # checked

REFERENCES = {"dop853": DOP853, "radau": Radau, "bdf": BDF}
RTOL = 1e-10  # of a method with error control, unless the caller says
CAREFUL = 0.1  # default dt of a fixed-step method, times the fastest rate of the arm
MOST_STEPS = 1e9  # of a fixed-step method: hours
WORTH = 100_000  # evaluations of DOP853, a few seconds, from which "auto" tries Radau's method
TRIAL = 8000  # evaluations of each to tell which gets farther: decaying starts are slow for both
DEARER = 4.0  # an implicit method's evaluation, with its share of Jacobians and linear algebra


class Diverged(RuntimeError):
    """A simulation left the finite numbers."""


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
    q, v : (n,) initial state; of a free base without its six, it starts where `Base` says.
    torque : (n_joint,) [N m] constant; a function of time, whose attribute `breakpoints`, if it
        has one, lists the times where it jumps; or None.
    times : (N,) [s] increasing output times.
    integrator : SciPy's "dop853" (explicit), "radau" or "bdf" (implicit, with exact Jacobians),
        which control their error; "auto", the cheaper of the first two, or a fixed-step method of
        INTEGRATORS, which holds a torque that varies at its value in mid-step. At one tolerance
        BDF's error is the largest, ten times the others' and more.
    dt : [s] largest step of a fixed-step method; default 0.1 over the fastest frequency or decay.
    rtol : relative tolerance of error control; default 1e-10.

    Warns with a `ValidityWarning` for each assumption of the model that the motion leaves at the
    output times, see `dynamics.limits`.

    Raises
    ------
    Diverged : naming the time and the remedy.
    ValueError : for arguments of wrong size, or a step beyond the method's stability limit.
    """
    base = validate.instance(model, "model", Model).arm.base
    start = (_state(model, q, base.q, "q"), _state(model, v, base.v, "v"))
    grid = validate.array(times, "times", (None,))
    if grid.size < 1 or np.any(np.diff(grid) <= 0.0):
        raise ValueError(f"times must hold one number at least, and increase, got {grid.size}.")
    validate.known(integrator, "integrator", ["auto", *REFERENCES, *INTEGRATORS])
    signal, jumps = _signal(model, torque)
    if integrator not in INTEGRATORS:
        if dt is not None:
            raise ValueError(
                f"dt ({validate.shown(dt)} s) is for fixed-step methods; {integrator} takes rtol."
            )
        accuracy = RTOL if rtol is None else validate.positive(rtol, "rtol", "-")
        motion = _Motion(model, start, signal, jumps, grid, accuracy)
        integrator = motion.cheapest() if integrator == "auto" else integrator
        states = motion.solve(integrator)
    else:
        if rtol is not None:
            raise ValueError(
                f"rtol ({validate.shown(rtol)}) is for error control; {integrator} takes dt."
            )
        states = _fixed_steps(model, start, signal, jumps, grid, integrator, dt)
    rates = states[:, model.n :]
    positions = states[:, : model.n]
    measured = np.empty((grid.size, model.n_measure))
    Stepper(model, 1, dt=1.0, substeps=1).measure(positions.copy(), rates.copy(), measured)
    place = positions[:, :3].copy() if base.n else None
    attitude = quaternion_state.quaternions(positions, base.quaternion) if base.n else None
    tip = measured[:, model.measurements["tip"]].copy()
    trajectory = Trajectory(grid, positions, rates, tip, place, attitude, integrator)
    for sentence in limits(model, trajectory):
        warnings.warn(sentence, ValidityWarning, stacklevel=2)
    return trajectory


def _state(model: Model, x: ArrayLike, base: tuple[float, ...], name: str) -> Array:
    array = validate.array(x, name, (None,))
    if array.shape == (model.n - len(base),):
        array = np.concatenate([base, array])
    return validate.array(array, name, (model.n,))


def _signal(
    model: Model, torque: TorqueSignal | ArrayLike | None
) -> tuple[Signal | Array, list[float]]:
    """The torque as a function or a constant, and the times where it jumps."""
    if torque is None:
        return np.zeros(model.n_joint), []
    numbers = partial(validate.array, shape=(model.n_joint,))
    if not callable(torque):
        return numbers(torque, "torque"), []

    def checked(t: float) -> Array:
        return numbers(torque(t), f"torque({t:.6g} s)")

    jumps = validate.numbers(
        list(getattr(torque, "breakpoints", ())), "torque.breakpoints", unit="s"
    )
    return checked, list(jumps)


class _Motion:
    """A motion for the methods with error control."""

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
        self.start = np.concatenate([self._opened(start[0]), start[1]])
        between = sorted(t for t in jumps if times[0] < t < times[-1])
        self.knots = [float(times[0]), *between, float(times[-1])]
        self._program = model.program(1, "rk4")
        self._w, self._out = model.workspace(self._program), np.empty((1, model.n))

    def _torque(self, t: float, begin: float, end: float) -> Array:
        """A jump belongs to the piece of motion that it starts."""
        if not callable(self.signal):
            return self.signal
        return self.signal(min(max(t, begin), np.nextafter(end, begin)))

    def _opened(self, q: Array) -> Array:
        """Coordinates that solvers integrate: of a free base, the attitude as a quaternion."""
        return quaternion_state.with_quaternion(q) if self.model.arm.base.n else q

    def solver(self, name: str, x: Array, begin: float, end: float) -> OdeSolver:
        """One of SciPy's, from state x, from jump to jump."""
        n, parameters = self.model.n, self.model.nominal_parameters[None]
        flies = self.model.arm.base.n > 0

        def derivative(t: float, x: Array) -> Array:
            tau = self._torque(t, begin, end)[None]
            q, v = (quaternion_state.with_rotation_vector(x[:-n]) if flies else x[:n]), x[-n:]
            self._program.evaluate_states(q[None], v[None], tau, parameters, self._w, self._out)
            return np.concatenate([quaternion_state.rates(x[:-n], v) if flies else v, self._out[0]])

        def jacobian(t: float, x: Array) -> Array:
            return self.model.linearize(x[:n], x[n:], self._torque(t, begin, end))[0]

        options = {} if name == "dop853" or flies else {"jac": jacobian}  # else by differences
        return REFERENCES[name](
            derivative, begin, x, end, rtol=self.rtol, atol=1e-2 * self.rtol, **options
        )

    @np.errstate(over="ignore", invalid="ignore")  # from what is not finite it steps back, or fails
    def solve(self, name: str) -> Array:
        """(N, 2 n) states at the times, from the method's dense output."""
        rows, n = self._rows(name), self.model.n
        if not self.model.arm.base.n:
            return rows
        positions = [quaternion_state.with_rotation_vector(x) for x in rows[:, :-n]]
        return np.hstack([positions, rows[:, -n:]])

    def _rows(self, name: str) -> Array:
        """States as solvers integrate them, at the times."""
        rows = np.empty((self.times.size, self.start.size))
        rows[0] = x = self.start
        done = 1
        for begin, end in pairwise(self.knots):
            solver = self.solver(name, x, begin, end)
            while solver.status == "running":
                try:
                    solver.step()
                except ValueError:  # SciPy's, of a matrix that is not finite
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
        """DOP853, unless Radau's method gets through the motion's start for less."""
        explicit = self._rate("dop853")
        if not explicit * (self.knots[-1] - self.knots[0]) > WORTH:
            return "dop853"
        return "radau" if DEARER * self._rate("radau") < explicit else "dop853"

    @np.errstate(over="ignore", invalid="ignore")
    def _rate(self, name: str) -> float:
        """Evaluations per second of motion, over the first TRIAL of them."""
        solver = self.solver(name, self.start, self.knots[0], self.knots[1])
        while solver.status == "running" and solver.nfev < TRIAL:
            solver.step()
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
    """Equal steps of at most `dt` between output times and jumps."""
    fastest = step_limits.fastest(model, start[0])
    duration = float(np.ptp(times))
    if dt is not None:
        largest = validate.positive(dt, "dt", "s")
    else:
        largest = CAREFUL / fastest if fastest else duration / 1000.0 or 1.0
    if duration > MOST_STEPS * largest:
        raise ValueError(
            f"dt must be at least {duration / MOST_STEPS:.3g} s, or {duration:.6g} s take more "
            f"than {MOST_STEPS:g} steps, got {largest:.3g} s; take a larger dt, a shorter motion, "
            "or a method with error control."
        )
    limit = step_limits.largest_step(model, start[0], integrator, largest)
    if limit < largest:
        raise ValueError(
            f"dt must be at most {limit:.3g} s, or {integrator} diverges from rest (fastest "
            f"frequency or decay {fastest:.4g} rad/s); got {dt!r} s. Take a smaller dt, or "
            f"'midpoint', which takes elastic forces implicitly."
        )
    stepper = Stepper(model, 1, dt=largest, substeps=1, integrator=integrator)
    stepper.q[0], stepper.v[0] = start
    rows = np.empty((times.size, 2 * model.n))
    rows[0] = np.concatenate(start)
    for k, (begin, end) in enumerate(pairwise(times), 1):
        knots = [begin, *(t for t in sorted(jumps) if begin < t < end), end]
        for left, right in pairwise(knots):
            _march(stepper, signal, left, right, largest)
        rows[k, : model.n], rows[k, model.n :] = stepper.q[0], stepper.v[0]
    return rows


def _march(
    stepper: Stepper, signal: Signal | Array, begin: float, end: float, largest: float
) -> None:
    """Equal steps from `begin` to `end`; a constant torque needs one call for all."""
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
