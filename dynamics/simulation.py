"""Follow one arm through time."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import DOP853

from dynamics.integrators import INTEGRATORS
from dynamics.model import Model
from dynamics.stepper import Stepper

Array = NDArray[np.float64]
TorqueSignal = Callable[[float], ArrayLike]

REFERENCE = "dop853"
RTOL = 1e-10  # of the reference method, unless the caller says
CAREFUL = 0.1  # default omega_max dt of a fixed-step method


class Diverged(RuntimeError):
    """A simulation left the finite numbers."""


@dataclass(frozen=True)
class Trajectory:
    """What `simulate` returns, one row per time."""

    t: Array  # (N,) [s]
    q: Array  # (N, n) [rad, m]
    v: Array  # (N, n) [rad/s, m/s]
    tip: Array  # (N, 3) [m]


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
    q, v : (n,) initial state.
    torque : (n_joint,) [N m] constant; a function of time, whose attribute `breakpoints`, if it
        has one, lists the times where it jumps; or None.
    times : (N,) [s] increasing output times.
    integrator : "auto" (SciPy's DOP853 with error control), "dop853", or a fixed-step method of
        INTEGRATORS. A fixed-step method holds a torque that varies at its value in mid-step.
    dt : [s] largest step of a fixed-step method; default 0.1 / omega_max.
    rtol : relative tolerance of DOP853; default 1e-10.

    Raises
    ------
    Diverged : naming the time and the remedy.
    ValueError : for arguments of wrong size, or a step beyond the method's stability limit.
    """
    start = (_state(model, q, "q"), _state(model, v, "v"))
    grid = np.asarray(times, dtype=np.float64)
    if grid.ndim != 1 or grid.size < 1 or not np.all(np.isfinite(grid)):
        raise ValueError(f"times must be a list of finite numbers, got shape {grid.shape}.")
    if np.any(np.diff(grid) <= 0.0):
        raise ValueError("times must increase.")
    known = ["auto", REFERENCE, *INTEGRATORS]
    if integrator not in known:
        raise ValueError(f"Unknown integrator {integrator!r}. Known: {known}.")
    signal, jumps = _signal(model, torque)
    if integrator in ("auto", REFERENCE):
        if dt is not None:
            raise ValueError(f"dt ({dt!r} s) is for fixed-step methods; DOP853 takes rtol.")
        states = _reference(model, start, signal, jumps, grid, RTOL if rtol is None else rtol)
    else:
        if rtol is not None:
            raise ValueError(f"rtol ({rtol!r}) is for DOP853; {integrator} takes dt.")
        states = _fixed_steps(model, start, signal, jumps, grid, integrator, dt)
    rates = states[:, model.n :]
    positions = states[:, : model.n]
    measured = np.empty((grid.size, model.n_measure))
    Stepper(model, 1, dt=1.0, substeps=1).measure(positions.copy(), rates.copy(), measured)
    return Trajectory(grid, positions, rates, measured[:, model.measurements["tip"]].copy())


def _state(model: Model, x: ArrayLike, name: str) -> Array:
    array = np.array(x, dtype=np.float64)
    if array.shape != (model.n,) or not np.all(np.isfinite(array)):
        raise ValueError(f"{name} must be {model.n} finite numbers, got {x!r}.")
    return array


def _signal(
    model: Model, torque: TorqueSignal | ArrayLike | None
) -> tuple[TorqueSignal | Array, list[float]]:
    """The torque as a function or a constant, and the times where it jumps."""
    if callable(torque):
        return torque, [float(t) for t in getattr(torque, "breakpoints", ())]
    constant = np.zeros(model.n_joint) if torque is None else np.array(torque, dtype=np.float64)
    if constant.shape != (model.n_joint,) or not np.all(np.isfinite(constant)):
        raise ValueError(f"torque must be {model.n_joint} finite numbers, got {torque!r}.")
    return constant, []


@np.errstate(over="ignore", invalid="ignore")  # divergence is found in the accelerations
def _reference(
    model: Model,
    start: tuple[Array, Array],
    signal: TorqueSignal | Array,
    jumps: list[float],
    times: Array,
    rtol: float,
) -> Array:
    """DOP853 from jump to jump, dense output at the times."""
    program = model.program(1, "rk4")
    w, out, n = model.workspace(program), np.empty((1, model.n)), model.n
    parameters = model.nominal_parameters[None]
    state = np.empty((2, 1, n))
    tau = np.empty((1, model.n_joint))
    between = 0.0  # a time inside the present step: a jump belongs to the piece it starts

    def derivative(t: float, x: Array) -> Array:
        state[:, 0] = x.reshape(2, n)
        tau[0] = signal(min(max(t, between), before_end)) if callable(signal) else signal
        program.evaluate_states(state[0], state[1], tau, parameters, w, out)
        if not np.all(np.isfinite(out)):
            raise _diverged(t)
        return np.concatenate([x[n:], out[0]])

    rows = np.empty((times.size, 2 * n))
    x = np.concatenate(start)
    rows[0] = x
    knots = [times[0], *(t for t in sorted(jumps) if times[0] < t < times[-1]), times[-1]]
    done = 1
    for begin, end in pairwise(knots):
        between, before_end = begin, np.nextafter(end, begin)
        solver = DOP853(derivative, begin, x, end, rtol=rtol, atol=1e-2 * rtol)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed":
                raise _diverged(solver.t)
            stop = int(np.searchsorted(times, solver.t, side="right"))
            if stop > done:
                rows[done:stop] = solver.dense_output()(times[done:stop]).T
                done = stop
        x = solver.y
    return rows


def _fixed_steps(
    model: Model,
    start: tuple[Array, Array],
    signal: TorqueSignal | Array,
    jumps: list[float],
    times: Array,
    integrator: str,
    dt: float | None,
) -> Array:
    """Equal steps of at most `dt` between output times and jumps."""
    fastest = float(model.frequencies(start[0], joints="free").max(initial=0.0))
    largest = CAREFUL / fastest if fastest else float(np.ptp(times)) / 1000.0
    largest = largest if dt is None else dt
    limit = INTEGRATORS[integrator].limit
    if not largest > 0.0 or largest * fastest > limit:
        raise ValueError(
            f"dt must be positive and at most {limit / fastest if fastest else limit:.3g} s, where "
            f"{integrator} is stable on the fastest mode ({fastest:.4g} rad/s); got {largest!r} s."
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
    stepper: Stepper, signal: TorqueSignal | Array, begin: float, end: float, largest: float
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


def _diverged(t: float) -> Diverged:
    return Diverged(
        f"The simulation diverged at t = {t:.6g} s; take a smaller dt or torque, or a stiffer arm."
    )
