"""Sensors of a rig: places of gauges and link angles, and what each reads of the coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.model import Model
from dynamics.types import Array

ROLLED_UP = 2.0 * np.pi  # [rad] curvature times length of a link that is bent into a circle


@dataclass(frozen=True, kw_only=True)
class Gauge:
    """A strain gauge that reads the bending of a link in its x-y plane."""

    link: int  # counted from 0
    x: float  # [m] from the root of the link
    distance: float = 1.0  # [m] from the neutral axis; 1 for a log of curvatures [1/m]

    def __post_init__(self) -> None:
        if not validate.number(self.distance, "Gauge.distance", "m"):
            raise ValueError(
                "Gauge.distance must not be 0: a gauge on the neutral axis reads nothing, got 0 m."
            )

    def row(self, model: Model) -> Array:
        """(n,) reading by q: strain [-], or curvature [1/m]."""
        strains = [model.strain(x, self.link, self.x)[2] for x in np.eye(model.n)]
        return self.distance * np.array(strains)


@dataclass(frozen=True, kw_only=True)
class LinkAngle:
    """The angle [rad] of a link's tip about its root, against the straight link: y / length."""

    link: int  # counted from 0

    def row(self, model: Model) -> Array:
        """(n,) reading by q."""
        return _tip(model, self.link)[0] / model.arm.links[self.link].length


@dataclass(frozen=True, kw_only=True)
class TipSlope:
    """The slope [rad] of a bent link's tip, against its root."""

    link: int  # counted from 0

    def row(self, model: Model) -> Array:
        """(n,) reading by q."""
        return _tip(model, self.link)[1]


Sensor = Gauge | LinkAngle | TipSlope
NOUNS = {Gauge: "gauge", LinkAngle: "link angle", TipSlope: "tip slope"}


def named(sensors: Sequence[Sensor]) -> list[str]:
    """Name of each sensor's signal: noun, and number among its kind from 1."""
    kinds = [type(sensor) for sensor in sensors]
    return [f"{NOUNS[kind]} {kinds[: k + 1].count(kind)}" for k, kind in enumerate(kinds)]


def check(sensors: Sequence[Sensor], arm: Arm, readings: Array) -> None:
    """Refuse links that the arm lacks or that do not bend, and gauges that would roll one up."""
    if readings.shape[1] != len(sensors):
        raise ValueError(
            f"Every gauge column needs a place, got {readings.shape[1]} columns and "
            f"{len(sensors)} places."
        )
    spans = np.nanmax(readings, axis=0, initial=0.0) - np.nanmin(readings, axis=0, initial=0.0)
    for name, sensor, span in zip(named(sensors), sensors, spans.tolist(), strict=True):
        validate.integer(sensor.link, f"{type(sensor).__name__}.link", 0, len(arm.links) - 1)
        if not arm.links[sensor.link].in_direction("y"):
            raise ValueError(
                f"{name} reads bending along y, which link {sensor.link + 1} "
                "lacks; name another link, or give this one modes along y (Link.modes)."
            )
        if not isinstance(sensor, Gauge):
            continue
        if span > abs(sensor.distance) * ROLLED_UP / arm.links[sensor.link].length:
            raise ValueError(
                f"{name} reads a change of curvature of {span / abs(sensor.distance):.3g} 1/m, "
                f"which would roll link {sensor.link + 1} up; check the gauge's unit and its "
                "distance from the neutral axis, and empty the cells of spikes."
            )


def _tip(model: Model, link: int) -> tuple[Array, Array]:
    """(n,) deflection [m] and (n,) slope [-] of a link's tip in its x-y plane by q."""
    way, slope = np.zeros(model.n), np.zeros(model.n)
    parts = model.chain.links[model.bodies[link]]
    places = model.chain.split(list(np.eye(model.n)))[model.bodies[link]]
    for part, (_, modes) in zip(parts, places, strict=True):
        way = way + part.length * slope
        for unit, phi, theta in zip(modes, part.tip_phi, part.tip_theta, strict=False):
            way, slope = way + phi[1] * unit, slope + theta[2] * unit
    return way, slope
