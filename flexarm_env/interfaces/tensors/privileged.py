"""True state of a batch for critics: numbers that the sensors do not show, scaled to about 1."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from dynamics.tracing.traced_arm import slices
from flexarm_env.core import Core
from flexarm_env.task.scales import EXTENT, MOVE

NAMES = (
    "joint_angle", "joint_rate", "modal_amplitude", "modal_rate", "base_position", "base_velocity",
    "base_turn", "joint_error", "elapsed", "parameters", "event", "delay",
    "gauge_bias",
)  # fmt: skip


class Privileged:
    """Function from the state of a batch to the numbers of a critic.

    Attributes
    ----------
    sizes : numbers of each part, in order; parts that an environment lacks are left out.
    """

    def __init__(self, core: Core) -> None:
        self._core, self._settings = core, core.settings
        self._joints = list(core.arm.joint_index)
        self._modal = [i for i in range(core.arm.base.n, core.arm.n) if i not in self._joints]
        self._rows = core.signals.state.slices
        self._prepare()
        one = torch.zeros((core.signals.state.total, 1), dtype=torch.float64)
        parts = self._parts(one)
        self.sizes = {name: len(parts[name]) for name in NAMES if len(parts[name])}

    @property
    def slices(self) -> dict[str, slice]:
        """Columns of each part."""
        return slices(self.sizes)

    def __call__(self, state: torch.Tensor) -> torch.Tensor:
        """(N, size) float32 numbers of a state of (rows, N)."""
        if self._settings is not self._core.settings:
            self._prepare()
        parts = self._parts(state)
        rows = torch.cat([parts[name] for name in self.sizes])
        return rows.T.to(torch.float32)

    def _prepare(self) -> None:
        """Centres and factors of what an episode draws."""
        self._settings = self._core.settings
        sensing = self._core.sensing
        ranges = torch.tensor(list(self._core.randomize.values()), dtype=torch.float64)
        self._parameters = _to_unit(ranges.reshape(-1, 2))
        drawn = sensing.ranges(self._core.gauge_scale) if sensing else np.zeros((2, 2))
        self._bias = _to_unit(torch.from_numpy(drawn[2:]))  # behind the key and the delay

    def _parts(self, state: torch.Tensor) -> Mapping[str, torch.Tensor]:
        """Rows of each part, one column per environment."""
        core, scales = self._core, self._core.scales

        def scaled(rows: torch.Tensor, unit: Any) -> torch.Tensor:
            units = torch.as_tensor(unit, dtype=state.dtype, device=state.device)
            return rows / units.reshape(-1, 1)

        def drawn(rows: torch.Tensor, to_unit: tuple[torch.Tensor, torch.Tensor]) -> torch.Tensor:
            centre, factor = (x.to(state)[:, None] for x in to_unit)
            return (rows - centre) * factor

        q, v = state[self._rows["q"]], state[self._rows["v"]]
        angles, rates, base = q[self._joints], v[self._joints], core.arm.base.n
        home = torch.as_tensor(scales.home).to(state)[:, None]
        start = torch.as_tensor(core.arm.base.position[:2]).to(state)[:, None]
        travel, turn = scales.base if base else (1.0, 1.0)
        moved = (travel, travel, turn)[:base]
        steps = max(core.max_steps, 1)
        none = state[:0]
        sensors = bool(core.sensing)
        return {
            "joint_angle": (angles - home) / EXTENT,
            "joint_rate": rates / core.rate_scale,
            "modal_amplitude": scaled(q[self._modal], scales.modal_scale),
            "modal_rate": scaled(v[self._modal], scales.modal_rate),
            "base_position": (q[:2] - start) / (0.1 * core.arm.reach) if base else none,
            "base_velocity": scaled(v[:base], moved) / core.rate_scale,
            "base_turn": torch.cat([torch.sin(q[2:3]), torch.cos(q[2:3])]) if base else none,
            "joint_error": (state[self._rows["target"]] - angles) / MOVE,
            "elapsed": state[self._rows["elapsed"]] * (core.max_steps > 0) / steps,
            "parameters": drawn(state[self._rows["free"]], self._parameters),
            "event": self._happened(state) if core.happening else none,
            "delay": self._delay(state) if sensors else none,
            "gauge_bias": drawn(state[self._rows["bias"]], self._bias) if sensors else none,
        }

    def _happened(self, state: torch.Tensor) -> torch.Tensor:
        """Rows of the event: if it has happened, its time, its signed sizes over the largest."""
        rows = self._core.happening.drawn if self._core.happening else {}
        time, size, sign = (state[self._rows[name]] for name in rows)
        first, *others = torch.from_numpy(self._core.starts[7][-sum(rows.values()) :]).to(state)
        ahead = (time - first.mean()) / (0.5 * (first[1] - first[0]))
        happened = (time < state[self._rows["elapsed"]]).to(state)
        most = [x[1] for x in others[: len(size)]]
        signed = [x * torch.sign(y) / z for x, y, z in zip(size, sign, most, strict=True)]
        return torch.stack([happened[0], ahead[0], *signed])

    def _delay(self, state: torch.Tensor) -> torch.Tensor:
        """Delay of the readings over the longest one that is drawn."""
        sensing = self._core.sensing
        latest = sensing.latest if sensing else 0
        delay = torch.floor(state[self._rows["delay"]]).clamp(max=latest)
        return delay / max(latest, 1)


def _to_unit(ranges: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres of ranges, and factors to [-1, 1]; 0 where a range is one number."""
    half = 0.5 * (ranges[:, 1] - ranges[:, 0])
    factor = torch.where(half > 0.0, 1.0 / half, torch.zeros_like(half))
    return ranges.mean(1), factor
