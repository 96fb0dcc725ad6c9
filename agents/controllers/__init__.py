"""Classical controllers with the interface of a trained policy.

To add one, write a class whose `predict` gives actions, and an entry of CONTROLLERS.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from agents.controllers.inverse import InverseDynamics
from agents.controllers.lqr import regulator
from agents.controllers.mpc import predictive
from agents.controllers.nmpc import nonlinear
from agents.controllers.observers.extended import ExtendedFilters
from agents.controllers.pd import JointPD, joint_pd, tune_pd
from agents.controllers.shaped import ShapedPD, ei, zv, zvd
from agents.controllers.simple import Random, Zero
from agents.controllers.strain import PID, IntegralResonant, PositivePosition, StrainFeedback
from agents.policy import Controller
from dynamics.description import validate
from flexarm_env import TASKS

__all__ = ["CONTROLLERS", "JointPD", "Kind", "controller", "joint_pd", "tune_pd"]

Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A controller of the table: how to build it, and what may be tuned."""

    build: Callable[..., Controller]  # (env, **parameters)
    # searched on a logarithmic scale where both ends are positive
    ranges: Mapping[str, Range] = field(default_factory=dict)
    obs: tuple[str, ...] = ("state", "sensors")  # kinds of observation that it can use
    tasks: tuple[str, ...] = tuple(TASKS)  # in which it takes part
    model: bool = False  # True if it computes with a model of the arm while it acts

    @property
    def middle(self) -> dict[str, float]:
        """Parameters in the middle of the ranges."""
        return {
            name: (low * high) ** 0.5 if low > 0.0 else 0.5 * (low + high)
            for name, (low, high) in self.ranges.items()
        }

    def checked(self, parameters: object, name: str) -> dict[str, float]:
        """A number for every key of the ranges, positive where its range is; refuses any other."""
        given = validate.mapping(parameters, name, self.ranges)
        if missing := [key for key in self.ranges if key not in given]:
            raise ValueError(f"{name} lacks {', '.join(missing)}; give all of {[*self.ranges]}.")
        return {
            key: (validate.positive if low > 0.0 else validate.number)(
                given[key], f"{name}.{key}", "-"
            )
            for key, (low, _) in self.ranges.items()
        }


def _on_model(
    name: str,
    build: Callable[..., Controller],
    ranges: Mapping[str, Range],
    tasks: tuple[str, ...] = tuple(TASKS),
    **keywords: Any,
) -> Kind:
    """A controller with a model, on sensors if its filter is tuned, else on exact states."""
    obs = "sensors" if "disturbance" in ranges else "state"
    made = partial(build, name=name, **keywords)
    return Kind(build=made, ranges=ranges, obs=(obs,), tasks=tasks, model=True)


_RESTING = tuple(name for name, task in TASKS.items() if not task.moving)
_PD = {"frequency_ratio": (0.05, 1.5), "damping_ratio": (0.15, 3.0)}
_SHAPED = _PD | {"rise": (0.05, 2.0)}
_PLAN = {"load": (0.03, 2.0)}
_COST = {"effort": (1e-4, 1e3), "lead": (0.003, 1.0)}
_LQR = _COST | {"clip": (0.05, 2.0)}
_PLANNED = _COST | _PLAN
_MPC = _COST | {"horizon": (0.3, 1.5), "margin": (0.5, 1.0)}
_FILTER = {"disturbance": (1e-5, 1.0)}
CONTROLLERS: dict[str, Kind] = {
    "pd": Kind(build=joint_pd, ranges=_PD),
    "pid": Kind(build=PID, ranges=_PD | {"reset": (0.1, 100.0)}),
    "strain": Kind(
        build=StrainFeedback, obs=("sensors",), ranges=_PD | {"yielding": (-2.0, 2.0)},
    ),
    "ppf": Kind(
        build=PositivePosition, obs=("sensors",),
        ranges=_PD | {
            "gain": (0.01, 10.0), "filter_ratio": (0.1, 3.0), "filter_damping": (0.1, 1.0),
        },
    ),
    "irc": Kind(
        build=IntegralResonant, obs=("sensors",),
        ranges=_PD | {"gain": (0.01, 10.0), "corner_ratio": (0.01, 3.0)},
    ),
    **{
        f"pd-{shaper.__name__}{'-2' * (modes == 2)}": Kind(
            build=partial(ShapedPD, shaper=shaper, modes=modes), ranges=_SHAPED, tasks=_RESTING,
            model=True,
        )
        for modes, shapers in ((1, (zv, zvd, ei)), (2, (zv, zvd)))
        for shaper in shapers
    },
    "inverse": Kind(build=InverseDynamics, ranges=_PD | _PLAN, model=True),
    "lqr": _on_model("lqr", regulator, _LQR),
    "lqg": _on_model("lqg", regulator, _LQR | _FILTER),
    "lqr-planned": _on_model("lqr-planned", regulator, _PLANNED, ("Reach",)),
    "lqg-planned": _on_model("lqg-planned", regulator, _PLANNED | _FILTER, ("Reach",)),
    "mpc": _on_model("mpc", predictive, _MPC),
    "mpc-kalman": _on_model("mpc-kalman", predictive, _MPC | _FILTER),
    "lqg-extended": _on_model(
        "lqg-extended", regulator, _LQR | _FILTER, filters=ExtendedFilters
    ),
    "lqg-extended-planned": _on_model(
        "lqg-extended-planned", regulator, _PLANNED | _FILTER, ("Reach",), filters=ExtendedFilters
    ),
    "mpc-extended": _on_model(
        "mpc-extended", predictive, _MPC | _FILTER, filters=ExtendedFilters
    ),
    "nmpc": _on_model("nmpc", nonlinear, _MPC, _RESTING),
    "nmpc-extended": _on_model("nmpc-extended", nonlinear, _MPC | _FILTER, _RESTING),
    "zero": Kind(build=lambda env: Zero(n_torque=env.unwrapped.torque_limit.size)),
    "random": Kind(build=lambda env: Random(env.unwrapped.torque_limit.size)),
}  # fmt: skip


def controller(name: str, env: Any, parameters: Mapping[str, float] | None = None) -> Controller:
    """A controller for an environment; without parameters in the middle of its ranges.

    Raises
    ------
    ValueError : for an unknown name, a parameter that is missing, unknown or not a number, or an
        observation that the controller cannot use.
    """
    kind = CONTROLLERS[validate.known(name, "controller", CONTROLLERS)]
    given = kind.middle if parameters is None else kind.checked(parameters, "parameters")
    return kind.build(env, **given)
