"""True state of a batch for critics: numbers that the sensors do not show, scaled to about 1."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from dynamics.tracing.traced_arm import slices
from dynamics.types import AnyArray, Array
from flexarm_env.core import Core
from flexarm_env.interfaces.tensors.results import ordinary
from flexarm_env.task.scales import EXTENT, MOVE

NAMES = (
    "joint_angle", "joint_rate", "modal_amplitude", "modal_rate", "base_position", "base_velocity",
    "base_turn", "target_now", "elapsed", "parameters", "event", "delay",
    "gauge_bias",
)  # fmt: skip


class Privileged:
    """Function from the state of a batch to the numbers of a critic.

    Attributes
    ----------
    sizes : numbers of each part, in order; parts that an environment lacks are left out.
    """

    def __init__(self, core: Core) -> None:
        self._core, self._rows = core, core.signals.state.slices
        self._joints = list(core.arm.joint_index)
        self._prepare()
        parts = self._parts(torch.zeros((core.signals.state.total, 1), dtype=torch.float64))
        self.sizes = {name: len(parts[name]) for name in NAMES if len(parts.get(name, ()))}

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

    def on_host(self) -> AnyArray:
        """(N, size) float32 numbers of the present state on the processor."""
        core = self._core
        numbers: AnyArray = self(torch.from_numpy(core.state)[:, : core.n_env]).numpy()
        return numbers

    @ordinary()
    def _prepare(self) -> None:
        """Rows of the parts that are linear in the state, their centres and factors."""
        core, scales = self._core, self._core.scales
        self._settings, arm, sensing = core.settings, core.arm, core.sensing
        at = {name: np.arange(x.start, x.stop) for name, x in self._rows.items()}
        q, v, joints, base = at["q"], at["v"], self._joints, arm.base.n
        modal = [i for i in range(base, arm.n) if i not in joints]
        linear: dict[str, tuple[AnyArray, Any, Any]] = {
            "joint_angle": (q[joints], scales.home, 1.0 / EXTENT),
            "joint_rate": (v[joints], 0.0, 1.0 / core.rate_scale),
            "modal_amplitude": (q[modal], 0.0, 1.0 / np.array(scales.modal_scale)),
            "modal_rate": (v[modal], 0.0, 1.0 / np.array(scales.modal_rate)),
            "elapsed": (at["elapsed"], 0.0, (core.max_steps > 0) / max(core.max_steps, 1)),
            "parameters": (at["free"], *_to_unit(list(core.randomize.values()))),
        }
        if base:
            travel, turn = scales.base
            moved = core.rate_scale * np.array([travel, travel, turn][:base])
            linear["base_position"] = (q[:2], arm.base.position[:2], 10.0 / arm.reach)
            linear["base_velocity"] = (v[:base], 0.0, 1.0 / moved)
        if sensing:
            drawn = sensing.ranges(core.gauge_scale)[2:]  # behind the key and the delay
            linear["gauge_bias"] = (at["bias"], *_to_unit(drawn))
        every = [np.broadcast_arrays(*x) for x in linear.values()]
        rows, *to_unit = (torch.from_numpy(np.concatenate(x)) for x in zip(*every, strict=True))
        self._linear = rows, *(x[:, None] for x in to_unit)
        self._lengths = {name: len(x[0]) for name, x in linear.items()}

    def _parts(self, state: torch.Tensor) -> Mapping[str, torch.Tensor]:
        """Rows of each part that the environment has, one column per environment."""
        core, (rows, centre, factor) = self._core, self._linear
        scaled = (state[rows.to(state.device)] - centre.to(state)) * factor.to(state)
        parts = dict(zip(self._lengths, scaled.split(list(self._lengths.values())), strict=True))
        q = state[self._rows["q"]]
        parts["target_now"] = (state[self._rows["target"]] - q[self._joints]) / MOVE
        if core.arm.base.n:
            parts["base_turn"] = torch.cat([torch.sin(q[2:3]), torch.cos(q[2:3])])
        if core.happening:
            parts["event"] = self._happened(state)
        if core.sensing:
            parts["delay"] = self._delay(state)
        return parts

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


def _to_unit(ranges: Any) -> tuple[Array, Array]:
    """Centres of ranges, and factors to [-1, 1]; 0 where a range is one number."""
    low, high = np.reshape(ranges, (-1, 2)).T
    half = 0.5 * (high - low)
    return 0.5 * (low + high), np.divide(1.0, half, out=np.zeros_like(half), where=half > 0.0)
