"""Inputs and outputs of an exported policy in SI units: what they are, and on which arm."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.hybrid.controller import KEY
from agents.policy import Policy, PolicyError
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.types import Array
from flexarm_env.accuracy.table import sentence
from flexarm_env.core import Core
from flexarm_env.pages.environments import components
from flexarm_env.task.observations import Layout

OWN = "last_action"  # part of an observation that an exported policy remembers itself
COLUMNS = ("index", "name", "of", "unit", "meaning")


@dataclass(frozen=True)
class Signals:
    """Inputs and outputs of a policy on an environment; the inputs are those parts of the
    observation that are measured or known, in SI units.
    """

    env_id: str
    arm: str
    control_dt: float  # [s]
    accuracy: str  # the certificate in words, or why there is none
    inputs: Layout
    of: tuple[str, ...]  # joints, links or axes of each part of the inputs
    driven: tuple[str, ...]  # (m,) what each output drives: a joint, the floating base
    largest: Array  # (m,) outputs at action 1
    units: tuple[str, ...]  # (m,) of the outputs

    @property
    def output(self) -> str:
        """Name of the outputs: torques, unless an actuator takes a command in another unit."""
        return "torque" if set(self.units) == {"N m"} else "command"

    def input_rows(self) -> list[tuple[str, ...]]:
        """COLUMNS of the inputs, one row per part of the observation."""
        slices = self.inputs.slices
        return [
            (span(slices[part.name]), part.name, of, part.unit, part.meaning)
            for part, of in zip(self.inputs.parts, self.of, strict=True)
        ]

    def output_rows(self) -> list[tuple[str, ...]]:
        """COLUMNS of the outputs."""
        return [
            (f"{j}", self.output, of, unit, f"at most {most:.6g}")
            for j, (of, most, unit) in enumerate(
                zip(self.driven, self.largest.tolist(), self.units, strict=True)
            )
        ]


def span(at: slice) -> str:
    """First and last index of a slice."""
    return f"{at.start}" if at.stop == at.start + 1 else f"{at.start} to {at.stop - 1}"


def driven(arm: Arm) -> tuple[str, ...]:
    """(n_torque,) what each torque acts on."""
    return (*(f"joint {j + 1}" for j in range(arm.n_joint)), *["base"] * arm.base.driven)


def _accuracy(core: Core) -> str:
    """Sentence about the error of an environment."""
    if core.certificate is None:
        return core.uncertified or ""
    return sentence(core.certificate, core.arm.reach)


def signals_of(policy: Policy, env_id: str, core: Core) -> Signals:
    """Inputs and outputs of a policy on its environment; raises PolicyError if it needs more."""
    refuse_base(policy.about)
    commands = core.actuation.command if core.actuation else ()
    units = [x.unit for x in core.actuation.laws] if core.actuation else []
    parts = tuple(part for part in core.layout.parts if part.name != OWN)
    found = Signals(
        env_id=env_id,
        arm=core.arm.name,
        control_dt=core.control_dt,
        accuracy=_accuracy(core),
        inputs=Layout(parts),
        of=tuple(components(core, part) for part in parts),
        driven=driven(core.arm),
        largest=np.append(commands, core.torque_limit[len(commands) :]),
        units=(*units, *("N m",) * (core.arm.n_torque - len(units))),
    )
    outputs, size = policy.layer_sizes[-1], found.inputs.size + found.largest.size
    if (policy.n_observation, outputs) != (size, found.largest.size):
        raise PolicyError(
            f"The policy takes {policy.n_observation} observations and gives {outputs} actions, "
            f"but {env_id} has {size} and {found.largest.size}; export it with the version of "
            "flexarm that trained it."
        )
    return found


def refuse_base(about: Mapping[str, Any]) -> None:
    """Refuse a policy that acts on a controller, whose program would have to go with it."""
    if KEY in about:
        base = about[KEY] if isinstance(about[KEY], Mapping) else {}
        raise PolicyError(
            f"The policy acts on the controller {validate.shown(base.get('controller'))} (learned: "
            f"{validate.shown(base.get('learned'))}), which has a model of the arm and cannot be "
            "exported; train one without, by learned: distilled for example."
        )
