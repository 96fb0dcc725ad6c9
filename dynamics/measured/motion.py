"""Signals of an arm under the command of a log, for many values of what a fit estimates."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.formulations.linearized import inertia
from dynamics.load import ArmSource, load_arm
from dynamics.measured import unknowns
from dynamics.measured.log_file import Log
from dynamics.measured.unknowns import LOCKED, Bounds, Unknowns
from dynamics.model import Model, compile_arm
from dynamics.simulation.stepper import Stepper
from dynamics.types import Array

STARTS = ("estimated", "rest")  # what is known of the state at the first sample
CONVERGED = 1e-3  # [of a signal's deviation] most change of a signal when the steps are halved
FINEST = 1e-7  # [of a signal's deviation] change that is small enough for every log
MOST_SUBSTEPS = 4096  # per sample
TOGETHER = (16, 512)  # fewest and most motions that are stepped together
MOST_NUMBERS = 20_000_000  # of motions that are stepped together
STRAIGHT = 1e-9  # [of the largest force] modal force at rest that counts as none
ROLLED_UP = 2.0 * np.pi  # [rad] curvature times length of a link that is bent into a circle
SCALED = {  # parameter: what it scales
    "stiffness": "a bending mode or a joint spring (Link.modes, Joint.stiffness)",
    "damping": "damping (Link.damping_ratio, Joint.spring_damping)",
    "friction": "joint friction (Joint.viscous, Joint.coulomb)",
}


@dataclass(frozen=True, kw_only=True)
class Gauge:
    """A strain gauge that reads the bending of a link in its x-y plane."""

    link: int  # counted from 0
    x: float  # [m] from the joint
    distance: float = 1.0  # [m] from the neutral axis; 1 for a log of curvatures [1/m]

    def __post_init__(self) -> None:
        if not validate.number(self.distance, "Gauge.distance", "m"):
            raise ValueError(
                "Gauge.distance must not be 0: a gauge on the neutral axis reads nothing, got 0 m."
            )


class LoggedMotion:
    """Signals of an arm under the command of a log, for many values of what a fit estimates.

    The signals are the encoders of joints that are not held, then the gauges.

    Parameters
    ----------
    bounds : (low, high) of the arm's free parameters.
    start : "estimated", or "rest": straight and at rest at the first readings.
    held : by joint, counted from 0, the angle [rad] or place [m] where it is held; None: the mean
        of its encoder, or 0 without one.
    """

    def __init__(
        self,
        source: ArmSource,
        log: Log,
        gauges: Sequence[Gauge],
        bounds: Bounds,
        *,
        start: str = "estimated",
        held: Mapping[int, float | None] | None = None,
    ) -> None:
        validate.choice(start, "start", STARTS)
        described, held = load_arm(source), dict(held or {})
        if described.base.n:
            raise ValueError(f"A fit needs a fixed base, got Base.type {described.base.type!r}.")
        n_joint = described.n_joint
        for joint in held:
            validate.integer(joint, "held joint (counted from 0)", 0, n_joint - 1)
        free = [joint for joint in range(n_joint) if joint not in held]
        self.log, self.substeps = log, 1
        self.command = _per_joint(
            log.command, "commands", n_joint, free, ", or none if the torque is zero throughout"
        )
        encoder = _per_joint(log.encoder, "encoders", n_joint, free)
        if log.gauge.shape[1] != len(gauges):
            raise ValueError(
                f"Every gauge column needs a place, got {log.gauge.shape[1]} columns and "
                f"{len(gauges)} places."
            )
        self.names = [f"encoder {k + 1}" for k in free]
        self.names += [f"gauge {k + 1}" for k in range(len(gauges))]
        self.measured = np.hstack([encoder[:, free], log.gauge])
        _check_signals(self.names, self.measured)
        self.deviation = self.measured.std(axis=0)
        arm = _with_held(described, held)
        self.model = compile_arm(arm, free_parameters=list(bounds))
        _check_scaled(self.model, bounds, free)
        rotors = _rotors(self.model)
        bends = [
            [g.distance * self.model.strain(x, g.link, g.x)[2] for x in np.eye(arm.n)]
            for g in gauges
        ]
        _check_gauges(arm, gauges, log.gauge)
        self.rows = np.vstack([rotors[free], np.reshape(bends, (-1, arm.n))])
        self.start = np.zeros(arm.n)
        self.start[list(arm.joint_index)] = [
            encoder[0, k] if k in free else _place(held[k], encoder[:, k]) for k in range(n_joint)
        ]
        rows = unknowns.asked(bounds)
        if start == "estimated":
            speeds = np.abs(np.diff(encoder, axis=0) / np.diff(log.time)[:, None]).max(axis=0)
            rates = {k: float(speeds[k]) for k in free}
            period = float(np.median(np.diff(log.time)))
            rows += unknowns.start(self.model, self.start, rotors, rates, period)
        else:
            self._check_rest()
        self.unknowns = Unknowns(rows)
        if self.measured.size <= len(rows) + len(self.names):
            raise ValueError(
                f"{len(log.time)} samples of {len(self.names)} signals are too few for the "
                f"{len(bounds)} parameters, {len(rows) - len(bounds)} numbers of the start and "
                "the offsets; log more samples, or start at rest."
            )

    def state(self, values: Array) -> tuple[Array, Array]:
        """q and v, (n,) or (P, n), at the start."""
        v = self.unknowns.changes("v", values)
        return self.start + self.unknowns.changes("q", values), v + np.zeros(self.model.n)

    def signals(self, values: Array, samples: int | None = None) -> Array:
        """(P, N, c) signals for values (P, k) of the unknowns; NaN after a motion has diverged."""
        count = len(self.log.time) if samples is None else samples
        size = self.together(count)
        return np.concatenate([
            self._signals(values[k : k + size], count) for k in range(0, len(values), size)
        ])  # fmt: skip

    def together(self, samples: int) -> int:
        """Number of motions that are stepped together."""
        least, most = TOGETHER
        return max(least, min(most, MOST_NUMBERS // (samples * self.model.n)))

    def _signals(self, values: Array, samples: int) -> Array:
        stepper = Stepper(self.model, len(values), dt=1.0, substeps=self.substeps)
        stepper.q[:], stepper.v[:] = self.state(values)
        stepper.parameters[:] = self.unknowns.changes("parameters", values)
        states = np.empty((samples, *stepper.q.shape))
        states[0] = stepper.q
        steps = np.diff(self.log.time[:samples]) / self.substeps
        failed = np.zeros(len(values), dtype=bool)
        for k, dt in enumerate(steps.tolist()):
            stepper.dt = dt
            stepper.torque[:] = self.command[k]
            stepper.advance()
            states[k + 1] = stepper.q
            failed |= stepper.status > 0
        states[:, failed] = np.nan
        return np.swapaxes(states @ self.rows.T, 0, 1)

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


def _check_signals(names: Sequence[str], measured: Array) -> None:
    if not names:
        raise ValueError(
            "A fit needs a gauge, or an encoder of a joint that is not held, got neither."
        )
    for name, column in zip(names, measured.T, strict=True):
        if not np.ptp(column):
            held = "hold its joint if that was clamped, or " if name.startswith("encoder") else ""
            raise ValueError(
                f"{name} never changes, it reads {column[0]:.6g} throughout; {held}name another "
                "column, or none."
            )


def _check_gauges(arm: Arm, gauges: Sequence[Gauge], readings: Array) -> None:
    """Refuse gauges that would roll a link up into a circle."""
    for k, (gauge, span) in enumerate(zip(gauges, np.ptp(readings, axis=0), strict=True), 1):
        if span > abs(gauge.distance) * ROLLED_UP / arm.links[gauge.link].length:
            raise ValueError(
                f"gauge {k} reads a change of curvature of {span / abs(gauge.distance):.3g} 1/m, "
                f"which would roll link {gauge.link + 1} up; check the gauge's unit and its "
                "distance from the neutral axis."
            )


def _check_scaled(model: Model, bounds: Bounds, free: Sequence[int]) -> None:
    """Refuse parameters that scale what the arm does not have."""
    for name in bounds:
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


def _rotors(model: Model) -> Array:
    """(n_joint, n) angle of every joint's rotor by q; it turns with the root of its link."""
    result = np.eye(model.n)[list(model.arm.joint_index)]
    first = 0
    for link in model.chain.links:
        modes = slice(first + (not link.welded), first + (not link.welded) + len(link.K))
        if link.driven:
            result[model.arm.joint_index.index(first), modes] = link.root_slope
        first = modes.stop
    return result


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
        return float(readings.mean())
    return validate.number(given, "angle of a held joint")
