"""Signals of an arm under the command of a log, for many values of what a fit estimates."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.formulations.linearized import inertia
from dynamics.load import ArmSource, load_arm
from dynamics.measured import sensors, unknowns
from dynamics.measured.log_file import ROWS, Log
from dynamics.measured.readings import Readings, delayed, low_passed
from dynamics.measured.sag import Sag
from dynamics.measured.sensors import Sensor
from dynamics.measured.unknowns import LOCKED, Bounds, Unknowns
from dynamics.model import Model, compile_arm
from dynamics.progress import Progress
from dynamics.simulation.sampled_motion import SampledMotion
from dynamics.types import AnyArray, Array

STARTS = ("estimated", "rest", "measured")  # what is known of the state at the first sample
CONVERGED = 1e-3  # [of a signal's deviation] most change of a signal when the steps are halved
FINEST = 1e-7  # [of a signal's deviation] change that is small enough for every log
MOST_SUBSTEPS = 4096  # per sample
TOGETHER = (16, 512)  # fewest and most motions that are stepped together
MOST_NUMBERS = 20_000_000  # of motions that are stepped together
TINY = 1e-30  # imaginary part of a complex number that carries a derivative
POLES = 2  # of the low pass of a signal, with one time constant: it is critically damped
FORGOTTEN = 8.0  # [of a time constant] after which the filter's state at the start counts as gone
STRAIGHT = 1e-9  # [of the largest force] modal force at rest that counts as none
WINDOW = 1.0 / 12.0  # [of the first mode's period] readings that tell a state
SCALED = {  # parameter: what it scales
    "stiffness": "bending mode or joint spring (Link.modes, Joint.stiffness)",
    "damping": "damping (Link.damping_ratio, Joint.spring_damping)",
    "friction": "joint friction (Joint.viscous, Joint.coulomb) beside viscous_1, coulomb_1, ...",
}


class LoggedMotion:
    """Signals of an arm under the command of a log, for many values of what a fit estimates.

    The signals are the encoders of joints that are not held, then gauges and angles of links.

    Parameters
    ----------
    bounds : (low, high) of the parameters.
    start : "estimated"; "rest": straight and at rest at the first readings; "measured": as the
        readings say, where links bend as their first natural modes, in others by gravity alone.
    held : by joint, counted from 0, the angle [rad] or place [m] where it is held; None: the mean
        of its encoder, or 0 without one.
    shooting : [s] after which the motion starts again from the readings, again and again.
    """

    def __init__(
        self,
        source: ArmSource,
        log: Log,
        gauges: Sequence[Sensor],
        bounds: Bounds,
        *,
        start: str = "estimated",
        held: Mapping[int, float | None] | None = None,
        shooting: float | None = None,
    ) -> None:
        validate.choice(start, "start", STARTS)
        described, held = load_arm(source), dict(held or {})
        if described.base.n:
            raise ValueError(f"A fit needs a fixed base, got Base.type {described.base.type!r}.")
        n_joint = described.n_joint
        for joint in held:
            validate.integer(joint, "held joint (counted from 0)", 0, n_joint - 1)
        free = [joint for joint in range(n_joint) if joint not in held]
        self.log, self.substeps, self.line = log, 1, Progress(False)
        self.command = _per_joint(
            log.command, "commands", n_joint, free, ", or none if the torque is zero throughout"
        )
        encoder = _per_joint(log.encoder, "encoders", n_joint, free)
        sensors.check(gauges, described, log.gauge)
        self.names = [f"encoder {k + 1}" for k in free] + sensors.named(gauges)
        self.measured = np.hstack([encoder[:, free], log.gauge])
        rows = unknowns.asked(bounds, described, self.names)
        asked, none = Unknowns(rows), np.zeros(len(self.names))
        delay, lag = (none + asked.changes(into, asked.high) for into in ("delay", "lag"))
        late = delay + (start != "rest") * FORGOTTEN * lag
        self.present = np.isfinite(self.measured) & (log.time[:, None] >= log.time[0] + late)
        _check_signals(self.names, self.measured, self.present, late)
        self.deviation = np.nanstd(self.measured, axis=0)
        arm = _with_held(unknowns.without_friction(described, bounds), held)
        scaled = [name for name in FREE_PARAMETERS if name in bounds]
        self.model = compile_arm(arm, free_parameters=scaled)
        self._follow = SampledMotion(self.model)
        _check_scaled(self.model, scaled, free)
        _check_moving(bounds, held)
        rotors = self.model.encoders
        bends = [sensor.row(self.model) for sensor in gauges]
        self.rows = np.vstack([rotors[free], np.reshape(bends, (-1, arm.n))])
        self.start = np.zeros(arm.n)
        self.start[list(arm.joint_index)] = [
            _first(encoder[:, k]) if k in free else _place(held[k], encoder[:, k])
            for k in range(n_joint)
        ]
        self._lift: Array | None = None
        self._sag: Sag | None = None
        self.restarts = self._points(start, shooting)
        if start == "estimated":
            rates = {k: _fastest(log.time, encoder[:, k]) for k in free}
            period = float(np.median(np.diff(log.time)))
            waits = log.time[np.isfinite(encoder[:, free]).argmax(axis=0)] - log.time[0]
            waits = waits + (delay + POLES * lag)[: len(free)]
            rows += unknowns.start(self.model, self.start, rotors, rates, waits, period)
        elif start == "measured":
            rows += unknowns.zeros(self.names, self.deviation, len(free))
            self._read_states(free, rotors, len(gauges))
        else:
            self._check_rest()
        self.unknowns = Unknowns(rows)
        self._has_delays = bool(delay.any() or lag.any())
        if self.present.sum() <= len(rows) + len(self.names):
            raise ValueError(
                f"{len(log.time)} samples of {len(self.names)} signals are too few for the "
                f"{len(bounds)} parameters, {len(rows) - len(bounds)} numbers of the start and "
                "the offsets; log more samples, or start at rest."
            )

    def _points(self, start: str, shooting: float | None) -> set[int]:
        """Samples after the first at which the motion starts again."""
        if shooting is None:
            return set()
        if start != "measured":
            raise ValueError(
                f'shooting needs start "measured", which tells the states, got start {start!r}.'
            )
        t = self.log.time
        times = np.arange(t[0] + validate.positive(shooting, "shooting", "s"), t[-1], shooting)
        return set(np.searchsorted(t, times - 1e-9).tolist())

    def _read_states(self, free: Sequence[int], rotors: Array, n_gauge: int) -> None:
        """Prepare states (n) from signals (c): joints turn, and links bend as their first modes."""
        shapes, omegas = unknowns.locked_modes(self.model, self.start, rotors[list(free)])
        if n_gauge > len(shapes):
            raise ValueError(
                f'start "measured" needs a bending mode for each gauge, got {len(shapes)} modes '
                f"and {n_gauge} gauges; name fewer gauges, or give the links more modes."
            )
        joints = np.eye(self.model.n)[np.array(self.model.arm.joint_index)[list(free)]]
        basis = np.vstack([joints, shapes[:n_gauge]]).T
        self._lift = basis @ np.linalg.inv(self.rows @ basis)
        self._unread = self.start - joints.T @ (joints @ self.start)
        if len(shapes) > n_gauge and any(self.model.arm.gravity):
            unread = np.eye(self.model.n) - self._lift @ self.rows
            self._sag = Sag(self.model, shapes, unread)
        span = WINDOW * 2.0 * np.pi / float(omegas[0]) if len(omegas) else 0.0
        self._readings = Readings(self.log.time, self.measured, span)

    def scales(self, values: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
        """Factors of torques (..., n_torque), gains, delays and lags [s] of signals (..., c).

        Any may be (1,).
        """
        above = values - self.unknowns.nominal
        torque, gain = (1.0 + self.unknowns.changes(into, above) for into in ("torque", "gain"))
        delay, lag = (self.unknowns.changes(into, values) for into in ("delay", "lag"))
        return torque, gain, delay, lag

    def state(self, values: AnyArray, sample: int = 0) -> tuple[AnyArray, AnyArray]:
        """q and v, (n,) or (P, n), at the first sample, or where the motion starts again."""
        if self._lift is None:
            v = self.unknowns.changes("v", values)
            return self.start + self.unknowns.changes("q", values), v + np.zeros(self.model.n)
        _, gain, delay, lag = self.scales(values)
        times = self.log.time[sample] + delay + POLES * lag + np.zeros(len(self.names))
        read, rates = self._readings.at(times)
        true = (read - self.unknowns.changes("zero", values)) / gain
        q = self._unread + true @ self._lift.T
        sag = self._sag(q, self._parameters(values)) if self._sag else 0.0
        return q + sag, rates / gain @ self._lift.T

    def _parameters(self, values: AnyArray) -> AnyArray:
        """(..., p) free parameters of the arm."""
        none = np.zeros((*values.shape[:-1], len(self.model.free_parameters)))
        return none + self.unknowns.changes("parameters", values)

    def signals(self, values: AnyArray, samples: int | None = None) -> AnyArray:
        """(P, N, c) signals for values (P, k) of the unknowns; NaN of a motion that diverges.

        Imaginary parts of the values are a direction, those of the signals the derivatives by it.
        """
        count = len(self.log.time) if samples is None else samples
        size = self.together(count)
        return np.concatenate([
            self._signals(values[k : k + size], count) for k in range(0, len(values), size)
        ])  # fmt: skip

    def slopes(self, values: Array, samples: int | None = None) -> Array:
        """(k, N, c) derivatives of the signals by the unknowns at values (k,), to round-off."""
        return self.signals(values + TINY * 1j * np.eye(values.size), samples).imag / TINY

    def together(self, samples: int) -> int:
        """Number of motions that are stepped together."""
        least, most = TOGETHER
        numbers = samples * self.model.n * (4 if self._has_delays else 2)
        return max(least, min(most, MOST_NUMBERS // numbers))

    def _signals(self, values: AnyArray, samples: int) -> AnyArray:
        """Signals (P, N, c): before each new start, and of the state when each was late."""
        self.line.motion(len(values))
        torque, gain, delay, lag = self.scales(values)
        before, after = self._paths(values, torque, samples)
        read = before[0]
        if self._has_delays:
            time, none = self.log.time[:samples], np.zeros((len(values), len(self.names)))
            for _ in range(POLES if lag.any() else 0):
                after, before = low_passed(time, after, before, lag + none)
            read = delayed(time, after, before, delay + none)
        return np.swapaxes(read * gain, 0, 1)

    def _paths(self, values: AnyArray, torque: AnyArray, samples: int) -> tuple[AnyArray, AnyArray]:
        """Readings (1, N, P, c) without gains and lateness, before and after each new start.

        Where a signal may be late, their rates too: (2, N, P, c).
        """
        n, count = self.model.n, len(values)
        torque = torque + np.zeros((count, self.model.n_torque))
        steps = np.diff(self.log.time[:samples]) / self.substeps
        first = [0, *sorted(k for k in self.restarts if k < len(steps))]
        starts = [
            np.hstack([np.broadcast_to(x, (count, n)) for x in self.state(values, k)])
            for k in first
        ]
        path = np.empty((samples, 2 * n, count), values.dtype)
        path[0] = starts[0].T
        for start, k, last in zip(starts, first, [*first[1:], len(steps)], strict=True):
            path[k + 1 : last + 1] = self._follow(
                steps[k:last], self.substeps, self.command[k:last, :, None] * torque.T,
                np.hstack([start, self._parameters(values)]).T,
            )  # fmt: skip
        path[..., ~np.isfinite(path).all(axis=(0, 1))] = np.nan
        if not self._has_delays:
            return self._read(path[None, :, :n]), self._read(path[None, :, :n])
        later = path.copy()
        later[first] = np.swapaxes(starts, 1, 2)
        before, after = (np.stack([x[:, :n], x[:, n:]]) for x in (path, later))
        return self._read(before), self._read(after)

    def _read(self, path: AnyArray) -> AnyArray:
        """Readings (..., P, c) of coordinates or rates (..., n, P)."""
        return np.swapaxes(self.rows @ path, -1, -2)

    def refine(
        self, values: Array, samples: int | None = None, error: Array | float = np.inf
    ) -> None:
        """Halve the steps until that changes the signals for values (P, k) by less than `error`.

        The error (c,) counts between FINEST and CONVERGED of the signals' deviations.
        """
        limit = np.clip(error, FINEST * self.deviation, CONVERGED * self.deviation)
        while not self._has_converged(values, samples, limit):
            self.halve_steps()

    def _has_converged(self, values: Array, samples: int | None, limit: Array) -> bool:
        if self.substeps == 1:
            return False
        fine = self.signals(values, samples)
        self.substeps //= 2
        coarse = self.signals(values, samples)
        self.substeps *= 2
        return bool(np.all(np.abs(fine - coarse).max(axis=(0, 1)) <= limit))  # False for NaN

    def halve_steps(self) -> None:
        """Double the steps per sample."""
        if self.substeps >= MOST_SUBSTEPS:
            raise ValueError(
                f"The arm does not converge with {self.substeps} steps per sample; check the units "
                "of the log, or give narrower bounds, fewer modes or a log with more samples."
            )
        self.substeps *= 2

    def _check_rest(self) -> None:
        """Refuse an arm that gravity bends, or that nothing moves."""
        forces = np.abs(self.model.bias(self.start, 0.0 * self.start))
        if np.delete(forces, list(self.model.arm.joint_index)).max(initial=0.0) > STRAIGHT:
            raise ValueError(
                "Gravity bends this arm at the first sample, so that it cannot start straight, as "
                'start "rest" says; let the start be estimated.'
            )
        if not self.command.any() and not forces.max() > STRAIGHT:
            raise ValueError(
                "Nothing moves: the torque is zero throughout, and the arm starts at rest, as "
                'start "rest" says; let the start be estimated, or give the torque.'
            )


def _per_joint(
    signals: Array, noun: str, n_joint: int, free: Sequence[int], default: str = ""
) -> Array:
    """(N, n_joint) signals of all joints: those of held joints may be left out and are zero.

    All may be left out where nothing is missing, or where zero is the default, in words.
    """
    count = signals.shape[1]
    if count == n_joint:
        return signals
    if count not in ((0, len(free)) if default else (len(free),)):
        some = f" ({len(free)} without held joints)" if len(free) < n_joint else ""
        raise ValueError(
            f"The arm needs {n_joint} {noun}{some}, got {count}; name a column for each joint"
            f"{default or ', or hold the joints that were clamped'}."
        )
    result = np.zeros((len(signals), n_joint))
    if count:
        result[:, free] = signals
    return result


def _check_signals(names: Sequence[str], measured: Array, present: Array, late: Array) -> None:
    """Refuse signals of few readings after the time [s] by which each may be late."""
    if not names:
        raise ValueError(
            "A fit needs a gauge, or an encoder of a joint that is not held, got neither."
        )
    for name, column, there, wait in zip(names, measured.T, present.T, late, strict=True):
        if there.sum() < ROWS[0]:
            after = f" after the first {wait:.3g} s, in which it may be late" if wait else ""
            raise ValueError(
                f"{name} holds {there.sum()} readings{after}, and a fit needs {ROWS[0]}; take more "
                "of the log, or name another column."
            )
        readings = column[np.isfinite(column)]
        if not np.ptp(readings):
            held = "hold its joint if that was clamped, or " if name.startswith("encoder") else ""
            raise ValueError(
                f"{name} never changes, it reads {readings[0]:.6g} throughout; {held}name another "
                "column, or none."
            )


def _check_scaled(model: Model, names: Sequence[str], free: Sequence[int]) -> None:
    """Refuse parameters that scale what the arm does not have."""
    for name in names:
        if FREE_PARAMETERS[name].apply(model.chain, 2.0) == model.chain:
            raise ValueError(
                f"{name} has no effect: the arm has no {SCALED[name]} to scale; give it some, or "
                f"leave {name} out of the fit."
            )
        if name == "friction" and not free:
            raise ValueError(
                "friction has no effect: all joints are held; leave friction out of the fit, or "
                "let a joint move."
            )


def _check_moving(names: Iterable[str], held: Iterable[int]) -> None:
    """Refuse friction and torque constants of joints that are held."""
    for joint in sorted(held):
        still = {f"{word}_{joint + 1}" for word in ("viscous", "coulomb", "torque")}
        for name in (x for x in names if x in still):
            raise ValueError(
                f"{name} has no effect: joint {joint + 1} is held; leave {name} out of the fit, "
                "or let the joint move."
            )


def _with_held(arm: Arm, held: Mapping[int, float | None]) -> Arm:
    """The arm with rotors too heavy to move in its held joints."""
    if not held:
        return arm
    M = inertia(compile_arm(arm).chain, np.zeros(arm.n))
    links = list(arm.links)
    for k in held:
        index = arm.joint_index[k]
        link = links[arm.joints[k]]
        joint = replace(link.joint, rotor_inertia=LOCKED * float(M[index, index]))
        links[arm.joints[k]] = replace(link, joint=joint)
    return replace(arm, links=tuple(links))


def _place(given: float | None, readings: Array) -> float:
    """Angle of a held joint: as given, or the mean of its encoder."""
    if given is None:
        there = readings[np.isfinite(readings)]
        if not there.size:
            raise ValueError(
                "The encoder of a held joint holds no readings; give the joint's angle, or leave "
                "the column out."
            )
        return float(there.mean())
    return validate.number(given, "angle of a held joint")


def _first(readings: Array) -> float:
    return float(readings[np.isfinite(readings)][0])


def _fastest(time: Array, readings: Array) -> float:
    """Largest rate between neighbouring readings."""
    there = np.isfinite(readings)
    return float(np.abs(np.diff(readings[there]) / np.diff(time[there])).max())
