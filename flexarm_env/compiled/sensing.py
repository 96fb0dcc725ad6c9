"""Imperfect sensors inside the compiled control step; `hardware` describes them.

Readings are taken at the end of every control step and kept as long as the longest delay needs.
Noise is a hash of a number drawn for the episode, of the step and of the sensor, so it does not
depend on the batch or on threads. It is the sum of four uniform numbers, scaled to the standard
deviation: nearly normal, and never beyond 3.5 standard deviations.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from dynamics.types import Array, Symbols
from flexarm_env.hardware.sensors import FINEST, Hardware

KEYS = 2.0**24  # episode keys; integers below it are exact in float32


class Sensing:
    """The sensors of an arm with m joints, g strain gauges and an accelerometer of a axes or none.

    Attributes
    ----------
    memory : rows of earlier readings in an environment's state, with their sizes.
    drawn : rows of the state that are drawn at a reset, with their sizes.
    gauges : columns of the model's "curvature".
    axes : axes of the tip along which the accelerometer reads; empty without one.
    noise : random numbers per step: of the gauges, then of the axes.
    """

    def __init__(
        self, hardware: Hardware, m: int, gauges: tuple[int, ...], axes: tuple[int, ...]
    ) -> None:
        self.hardware, self.gauges, self._m = hardware, gauges, m
        self.axes = () if hardware.accelerometer_noise is None else axes
        self.noise = len(gauges) + len(self.axes)
        self.latest = hardware.delay[1]
        g = len(gauges)
        self.memory = {"angles": m * (self.latest + 1), "curvatures": g * self.latest}
        self.drawn = {"key": 1, "delay": 1, "bias": g}
        self.constants = {"encoder_step": 1, "gauge_step": g, "gauge_noise": g}
        if self.axes:
            self.memory |= {"accelerations": len(self.axes) * self.latest, "tip_velocity": 3}
            self.constants["accelerometer_noise"] = 1

    @property
    def key(self) -> str:
        """Cache key: the properties on which the compiled functions depend."""
        return f"sensing {self.latest} {self._m} {self.gauges} {self.axes}"

    def ranges(self, scale: Array) -> Array:
        """(n_drawn, 2) ranges of the drawn rows; `scale` [1/m] is that of each gauge."""
        h, bias = self.hardware, self.hardware.gauge_bias * scale
        return np.array(
            [(0.0, KEYS), (h.delay[0], h.delay[1] + 1.0), *zip(-bias, bias, strict=True)]
        )

    def numbers(self, scale: Array, acceleration: float) -> dict[str, Any]:
        """Values of `constants`; `scale` [1/m] is of each gauge, `acceleration` [m/s^2] a scale."""
        h = self.hardware
        turn = 2.0 * math.pi / h.encoder_counts if h.encoder_counts else FINEST
        count = 1.0 / h.gauge_counts if h.gauge_counts else FINEST
        return {
            "encoder_step": turn,
            "gauge_step": count * scale,
            "gauge_noise": h.gauge_noise * scale,
            "accelerometer_noise": (h.accelerometer_noise or 0.0) * acceleration,
        }

    def readings(
        self, s: Symbols, joints: Any, curvature: Any, tip: Mapping[str, Any]
    ) -> tuple[dict[str, Any], Any]:
        """Signals that the sensors give, and the readings to keep.

        Parameters
        ----------
        s : symbols of the memory, the drawn rows, the constants, "noise" and "elapsed".
        joints : [rad] true joint angles.
        curvature : [1/m] true curvatures of all links.
        tip : with an accelerometer, "velocity" (3,) [m/s] of the tip, its "axes" (3, 3) as columns
            and "gravity" (3,) [m/s^2], all in the world.
        """
        import casadi as ca

        angle = _quantised(joints, s["encoder_step"])
        exact = curvature[list(self.gauges)]
        random = s["noise"][: len(self.gauges)]
        bent = _quantised(exact + s["bias"] + s["gauge_noise"] * random, s["gauge_step"])
        angles = self._history(s, angle, s["angles"])
        bends = self._history(s, bent, s["curvatures"])
        earlier, late = angles[1:], ca.fmin(ca.floor(s["delay"]), self.latest)
        rates = [(a - b) / s["control_dt"] for a, b in zip(angles[:-1], earlier, strict=True)]
        measured = ca.SX(curvature)
        measured[list(self.gauges)] = _chosen(bends, late)
        signals = {
            "angle": _chosen(angles[:-1], late),
            "rate": _chosen(rates, late),
            "curvature": measured,
        }
        kept = [*angles[:-1], *bends[:-1]]
        if self.axes:
            forces = self._history(s, self._specific_force(s, tip), s["accelerations"])
            felt = ca.SX(3, 1)
            felt[list(self.axes)] = _chosen(forces, late)
            signals["acceleration"] = felt
            kept += [*forces[:-1], tip["velocity"]]
        return signals, ca.vertcat(*kept)

    def _specific_force(self, s: Symbols, tip: Mapping[str, Any]) -> Any:
        """(a,) [m/s^2] mean acceleration over the control step minus gravity, along the tip's axes.

        The axes are those at the end of the step. At a start the tip counts as unaccelerated.
        """
        import casadi as ca

        velocity, before = self._history(s, tip["velocity"], s["tip_velocity"])
        force = ca.mtimes(tip["axes"].T, (velocity - before) / s["control_dt"] - tip["gravity"])
        return force[list(self.axes)] + s["accelerometer_noise"] * s["noise"][len(self.gauges) :]

    def _history(self, s: Symbols, present: Any, kept: Any) -> list[Any]:
        """The present reading and the kept ones, latest first; at a start all are the present."""
        size = present.numel()
        earlier = [kept[i : i + size] for i in range(0, kept.numel(), max(size, 1))]
        live = s["elapsed"] > 0.0
        return [present, *(live * reading + (1.0 - live) * present for reading in earlier)]


def _quantised(value: Any, step: Any) -> Any:
    import casadi as ca

    return step * ca.floor(value / step + 0.5)


def _chosen(values: list[Any], index: Any) -> Any:
    """The entry at a whole-numbered symbol."""
    import casadi as ca

    return sum((ca.fabs(index - k) < 0.5) * value for k, value in enumerate(values))
