"""Experts that are told what sensors hide: the exact state, and the present plant.

A policy that sees less than its expert learns the mean of what the expert does in the states that
may lie behind its observations. For a linear law that is the law at the mean of these states, which
no filter has to find (D. Chen, B. Zhou, V. Koltun and P. Krähenbühl, Learning by cheating, CoRL
2019).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS, controller
from agents.controllers.models.linear_model import NOMINAL
from agents.controllers.models.memory import Remembering
from agents.controllers.observers.exact import PLANT
from agents.policy import Controller
from dynamics.types import AnyArray, Array
from flexarm_env.task.observations import observation_layout


class Knowledge:
    """A batch as controllers see it, with exact states and present plants for observations."""

    def __init__(self, env: Any) -> None:
        seen, core = env.unwrapped, env.unwrapped.core
        layout = observation_layout(core.arm, core.task, "state", core.scales, core.rate_scale)
        self.unwrapped, self.core = self, core
        self.torque_limit, self.reach = seen.torque_limit, seen.reach
        self.observation_slices = layout.slices | {PLANT: slice(layout.size, layout.size + 2)}
        self.observation_scales = layout.scales | {PLANT: np.ones(2)}
        self._seen, joints = seen.observation_slices, core.arm.joint_index
        self._modal = [i for i in range(core.arm.base.n, core.arm.n) if i not in joints]

    def told(self, observation: AnyArray) -> Array:
        """(N, size) present state, target and plant; what sensors show of the target's path."""
        core = self.core
        angle, rate = core.joint_state()
        known = {
            "joint_error": angle - core.joint_target(), "joint_rate": rate,
            "joint_sin": np.sin(angle), "joint_cos": np.cos(angle),
            "modal_amplitude": core.q[:, self._modal], "modal_rate": core.v[:, self._modal],
            PLANT: self._plants(),
        }  # fmt: skip
        found = np.zeros((core.n_env, self.observation_slices[PLANT].stop))
        for name, part in self.observation_slices.items():
            if name in known:
                columns = known[name][:, part.start - part.stop :]  # joint 1 may not be observed
                found[:, part] = columns / self.observation_scales[name]
            elif name in self._seen:
                found[:, part] = observation[:, self._seen[name]]
        return found

    def _plants(self) -> Array:
        """(N, 2) values of NOMINAL: as drawn, without a payload that has been dropped."""
        core, drawn = self.core, list(self.core.randomize)
        columns = [
            core.parameters[:, drawn.index(name)] if name in drawn else np.full(core.n_env, usual)
            for name, usual in NOMINAL.items()
        ]
        plants = np.stack(columns, axis=1).astype(np.float64)
        if core.happening and core.happening.name == "drop":
            rows = core.signals.state.slices
            now = {x: core.state[rows[x], : core.n_env][0] for x in ("event_time", "elapsed")}
            plants[core.happening.happened(now), 0] = 0.0
        return plants


class Informed(Remembering):
    """A controller of exact states in a batch whose observations are those of sensors.

    It acts at the present state of the batch; of an observation it reads the target's path alone.
    """

    def __init__(self, name: str, env: Any, parameters: Mapping[str, float] | None) -> None:
        self._knowledge = Knowledge(env)
        self._controller: Any = controller(name, self._knowledge, parameters)

    def act(self, x: AnyArray, memory: Any, fresh: AnyArray) -> tuple[AnyArray, Any]:
        """The controller's actions and memory at what it is told."""
        action, memory = self._controller.act(self._knowledge.told(x), memory, fresh)
        return action, memory


def is_told(name: str, env: Any) -> bool:
    """True if a controller of this name must be told what the observations hide."""
    seen = env.unwrapped.observation_slices
    sensors = "joint_error" in seen and "tip_error" not in seen
    return sensors and CONTROLLERS[name].obs == ("state",)


def expert(name: str, env: Any, parameters: Mapping[str, float] | None) -> Controller:
    """A controller that a policy imitates in this batch, told its state where it must be."""
    return (Informed if is_told(name, env) else controller)(name, env, parameters)
