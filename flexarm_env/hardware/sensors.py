"""Imperfect sensors and a drawn plant: the keyword `hardware`.

An encoder reads the joint angle in whole counts, and the joint rate is the difference of two
readings over a control step. A strain gauge reads the curvature at a link's root with noise, a
bias and in whole counts. An accelerometer at the tip, if there is one, turns with the last link and
reads acceleration minus gravity with noise. All readings arrive late by a number of control steps.
Bias, delay, payload and stiffness are drawn at every reset, noise at every step, from the
environment's stream.

To add a preset, add an entry to PRESETS.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from dynamics.description import validate
from dynamics.description.arm import Arm
from flexarm_env.task.events import payload

MOST_DELAY = 8  # [control steps]
MOST_COUNTS = 2**24  # per turn, and per scale of a gauge
FINEST = 2.0**-24  # [rad], [of the scale] resolution of readings without counts
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Hardware:
    """Sensors and spread of an environment; the default is exact but for the joint rate."""

    encoder_counts: int | None = None  # per turn of the joint; None: exact angles
    gauge_noise: float = 0.0  # [-] standard deviation over the curvature at 10 % deflection
    gauge_bias: float = 0.0  # [-] largest, over the same curvature
    gauge_counts: int | None = None  # per this curvature; None: not quantised
    # [-] standard deviation over the acceleration scale; None: no accelerometer
    accelerometer_noise: float | None = None
    delay: tuple[int, int] = (0, 0)  # [control steps] smallest and largest
    payload: Range | None = None  # [-] added mass over that of the last link with its tip
    stiffness: Range | None = None  # [-] factor on all stiffnesses

    def __post_init__(self) -> None:
        for name in ("encoder_counts", "gauge_counts"):
            if getattr(self, name) is not None:
                validate.integer(getattr(self, name), f"hardware.{name}", 1, MOST_COUNTS)
        for name in ("gauge_noise", "gauge_bias"):
            value = validate.nonnegative(getattr(self, name), f"hardware.{name}", "-")
            object.__setattr__(self, name, value)
        self._check_accelerometer()
        for name in ("payload", "stiffness"):
            if getattr(self, name) is not None:
                low, high = validate.numbers(getattr(self, name), f"hardware.{name}", 2)
                if not 0.0 <= low <= high:
                    raise ValueError(
                        f"hardware.{name} must be (low, high) with 0 <= low <= high, got "
                        f"{validate.shown(getattr(self, name))}."
                    )
        object.__setattr__(self, "delay", self._checked_delay())

    def _check_accelerometer(self) -> None:
        if self.accelerometer_noise is not None:
            try:
                noise = validate.nonnegative(
                    self.accelerometer_noise, "hardware.accelerometer_noise", "-"
                )
            except ValueError as error:
                raise ValueError(
                    f"{error} It is a share of the acceleration scale, 0.01 for 1 %; leave it out "
                    "for no accelerometer."
                ) from None
            object.__setattr__(self, "accelerometer_noise", noise)

    def _checked_delay(self) -> tuple[int, int]:
        """Smallest and largest delay; one number stands for both."""
        one = not isinstance(self.delay, list | tuple)
        pair = [self.delay, self.delay] if one else list(self.delay)
        if len(pair) != 2:
            raise ValueError(
                "hardware.delay must be a number of control steps, or the smallest and the "
                f"largest, got {validate.shown(self.delay)}."
            )
        least = validate.integer(pair[0], "hardware.delay[0]", 0, MOST_DELAY)
        return least, validate.integer(pair[1], "hardware.delay[1]", least, MOST_DELAY)

    def spread(self, arm: Arm) -> dict[str, Any]:
        """Ranges of drawn parameters of an arm, as the keyword `randomize` takes them."""
        result: dict[str, Any] = {}
        if self.payload is not None:
            result["payload_mass"] = payload(arm, self.payload)
        if self.stiffness is not None:
            result["stiffness"] = self.stiffness
        return result


PRESETS: dict[str, Hardware | None] = {
    "ideal": None,
    # An encoder of 1024 lines read in quadrature, an amplifier of 12 bits, a network of 50 Hz
    "laboratory": Hardware(
        encoder_counts=4096, gauge_noise=0.01, gauge_bias=0.01, gauge_counts=1000, delay=(0, 2),
        payload=(0.0, 0.5), stiffness=(0.9, 1.1),
    ),
}  # fmt: skip


def load_hardware(source: object) -> Hardware | None:
    """Hardware from a preset's name or a dict of fields; None for ideal hardware.

    A dict may name a preset under "preset" and change some of its numbers.
    """
    if source is None or isinstance(source, Hardware):
        return source
    if isinstance(source, str):
        return PRESETS[validate.known(source, "hardware", PRESETS)]
    names = [f.name for f in fields(Hardware)]
    if not isinstance(source, Mapping):
        raise ValueError(
            f"hardware must be one of {sorted(PRESETS)} or a dict of {names}, got "
            f"{validate.shown(source)}."
        )
    data: dict[str, Any] = validate.mapping(source, "hardware", ["preset", *names])
    preset = PRESETS[validate.known(data.pop("preset", "ideal"), "hardware.preset", PRESETS)]
    given = {} if preset is None else {name: getattr(preset, name) for name in names}
    return Hardware(**(given | data))


def refuse_exact_state(obs: object, hardware: Hardware | None) -> None:
    """Raise a ValueError for an exact observation beside imperfect hardware."""
    if hardware and obs in ("state", "goal"):
        raise ValueError(
            f"obs must be 'sensors' beside hardware, got {obs!r}: modal amplitudes and the tip are "
            "not measured; leave out obs."
        )
