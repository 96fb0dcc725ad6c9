"""Physical quantities from the observations of an environment, and their errors."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.types import AnyArray, Array
from flexarm_env.hardware.sensors import Hardware

LATER = 1  # control steps by which filters expect more delay than may be drawn
EXACT = 1e-4  # [rad], [of the scale] steps that stand for readings without counts
UNIFORM = 3.0**0.5  # half the width of a uniform distribution over its standard deviation


@dataclass(frozen=True)
class Reading:
    """Parts of an observation in physical units; observations are (size,) or (N, size)."""

    slices: dict[str, slice]
    scales: dict[str, Array]

    @classmethod
    def of(cls, env: Any) -> "Reading":
        """Reading of an environment or a batch."""
        base = env.unwrapped
        return cls(base.observation_slices, base.observation_scales)

    def __contains__(self, name: str) -> bool:
        return name in self.slices

    def __call__(self, observation: AnyArray, name: str) -> Array:
        """(..., k) values of a part."""
        x = np.asarray(observation, dtype=np.float64)
        return np.asarray(x[..., self.slices[name]] * self.scales[name])

    def require(self, controller: str, *names: str) -> None:
        """Refuse an environment whose observations lack a part."""
        missing = [name for name in names if name not in self]
        if missing == ["root_curvature"] and "modal_amplitude" not in self:
            raise ValueError(
                f"{controller} reads strain gauges, of which this arm has none: its links are "
                "rigid, or have pinned-free modes."
            )
        if "modal_amplitude" in missing and "tip_error" in self:
            raise ValueError(
                f"{controller} takes an arm that bends, but this one has neither modes nor joint "
                "springs; use pd."
            )
        if missing:
            kind = "state" if "modal_amplitude" in names else "sensors"
            raise ValueError(
                f"{controller} needs obs={kind!r}: the observation has no {', '.join(missing)}."
            )


@dataclass(frozen=True)
class Sensors:
    """Errors of the sensors of an environment with m joints and g gauges."""

    delay: tuple[int, int]  # [control steps] least and most that may be drawn
    delays: list[int]  # [control steps] that filters expect
    quantum: Array  # (m + g,) steps between readings
    noise: Array  # (m + g,) standard deviations of the readings
    bias: Array  # (g,) [1/m] standard deviation of a gauge's bias

    @classmethod
    def of(cls, core: Any) -> "Sensors":
        """Sensors of an environment's core; those of ideal hardware are nearly exact."""
        scale, m = np.asarray(core.gauge_scale), core.arm.n_joint
        hardware = core.sensing.hardware if core.sensing else Hardware()
        count = 2.0 * np.pi / hardware.encoder_counts if hardware.encoder_counts else EXACT
        step = 1.0 / hardware.gauge_counts if hardware.gauge_counts else EXACT
        noise = np.hypot(hardware.gauge_noise, 0.5 * step / UNIFORM) * scale
        least, most = hardware.delay
        return cls(
            delay=hardware.delay,
            delays=list(range(least, most + 1 + LATER * (most > least))),
            quantum=np.array([*[count] * m, *(step * scale)]),
            noise=np.array([*[0.5 * count / UNIFORM] * m, *noise]),
            bias=hardware.gauge_bias / UNIFORM * scale,
        )
