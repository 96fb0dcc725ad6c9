"""Checks of an environment's keywords; each returns the clean value or raises a ValueError."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from enum import Enum
from numbers import Integral, Real
from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics import Arm
from dynamics.description import validate
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.types import Array

CONTROL_DT = (1e-6, 10.0)  # [s]
DEFLECTION_LIMITS = (1e-6, 1.0)  # [-]
MOST_STEPS = 10_000_000  # per episode; float32 counts integers up to 1.6 times this
MOST_SUBSTEPS, MOST_BY_RULE = 1_000_000, 5000  # per control step: as a keyword, and by a rule
MOST_DRAWN = 1e6  # of a free parameter: [kg] or times its nominal value
FARTHEST_START = 1e4  # [rad], [m], [rad/s], [m/s] of a state or target; over a thousand turns
MOST_SEED = 2**128 - 1


def torque_limits(given: float | Sequence[float] | None, default: tuple[float, ...]) -> Array:
    """(n_joint,) [N m] torque limits from one number, one per joint, or None (`default`)."""
    if given is None:
        return np.array(default)
    count = len(default)
    limits: object = given.tolist() if isinstance(given, np.ndarray) else given
    if isinstance(limits, Real):
        limits = count * [limits]
    if not isinstance(limits, list | tuple) or len(limits) != count:
        raise ValueError(
            f"torque_limit must be one number, or a list of {count} (one per joint), "
            f"got {validate.shown(given)}. Unit: [N m]."
        )
    return np.array([validate.positive(limit, "torque_limit", "N m") for limit in limits])


def check_base(arm: Arm, base_torque: float | None) -> None:
    """Refuse a base that no environment moves, and a torque [N m] on one that does not turn."""
    base = arm.base
    if base.spatial:
        raise ValueError(
            "Base.type must be 'fixed' or 'planar' for an environment, got 'free'; step a base "
            "that turns in space with dynamics.Stepper."
        )
    if base_torque is not None:
        if not base.n:
            raise ValueError(
                f"base_torque ({validate.shown(base_torque)} N m) needs a base that turns, but "
                "Base.type is 'fixed'; leave it out."
            )
        validate.positive(base_torque, "base_torque", "N m")
    if base.driven:
        raise ValueError(
            "Base.driven must be left out for an environment, got True; base_torque drives the "
            "base and limits its torque [N m]."
        )
    if any(base.v):
        raise ValueError(
            f"Base.velocity and Base.angular_velocity_body must be zero for an environment, got "
            f"{validate.shown(base.v)}; set rates with reset(options={{'state': ...}})."
        )
    if base.n and any(arm.gravity[:2]):
        raise ValueError(
            f"Arm.gravity ({validate.shown(arm.gravity)} m/s^2) must be along z where a base "
            "floats in the x-y plane: an arm that falls holds no target."
        )


def ranges(given: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Checked ranges (low, high) of free parameters by name, of the keyword `randomize`."""
    if not isinstance(given, Mapping):
        raise ValueError(
            "randomize must be a dict of (low, high) by free parameter, got "
            f"{validate.shown(given)}."
        )
    for name in given:
        validate.known(name, "randomize", FREE_PARAMETERS)
    return {name: drawn(name, pair, f"randomize[{name!r}]") for name, pair in given.items()}


def drawn(name: str, pair: tuple[float, float], what: str) -> tuple[float, float]:
    """Checked range (low, high) of a free parameter, which errors call `what`."""
    low, high = validate.numbers(pair, what, 2)
    if not 0.0 <= low <= high <= MOST_DRAWN:
        raise ValueError(
            f"{what} must be (low, high) with 0 <= low <= high <= {MOST_DRAWN:g}, got "
            f"{validate.shown(pair)}."
        )
    if name == "stiffness" and not high:
        raise ValueError(
            f"{what}, a factor on every stiffness, must be above 0 at the upper end of its range, "
            f"got {validate.shown(pair)}; links without stiffness are no arm."
        )
    return low, high


def within(name: str, value: object, least: float, most: float, unit: str) -> float:
    """Return a number in [least, most]."""
    result = validate.number(value, name, unit)
    if not least <= result <= most:
        raise ValueError(
            f"{name} must be between {least:g} and {most:g}, got {result!r}. Unit: [{unit}]."
        )
    return result


def curvature_limit(given: object, gauges: tuple[int, ...]) -> float | None:
    """Return a limit of the curvature that strain gauges `gauges` read, or None."""
    if given is None:
        return None
    if not gauges:
        raise ValueError(
            f"curvature_limit ({validate.shown(given)}) needs a link that bends at its root, but "
            "all links are rigid or have pinned-free modes; leave it out."
        )
    return validate.positive(given, "curvature_limit", "-")


def episode_steps(given: Any, own: int = 0) -> int:
    """Control steps per episode, 0 for no limit, from Gymnasium's `max_episode_steps`.

    None stands for `own`, the limit of the id, and -1 for no limit.
    """
    if given is None:
        return own
    if isinstance(given, Integral) and given == -1:
        return 0
    try:
        return validate.integer(given, "max_episode_steps", 1, MOST_STEPS)
    except ValueError as error:
        raise ValueError(
            f"{error} -1 stands for no limit, and None for that of the id, if there is one."
        ) from None


def plain(value: Any) -> Any:
    """Keywords as JSON types, which give the same environment; other objects stay as they are."""
    if isinstance(value, Arm):
        return value.to_dict()
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Real) and not isinstance(value, int | float):
        return float(value)
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, Enum):
        return value.value
    return value


def placements(options: Any, arm: Arm, n_row: int) -> dict[str, Array]:
    """State rows that reset options set instead of drawing: "q", "v" and "centre" (the target)."""
    if not isinstance(options, Mapping):
        raise ValueError(f"options must be a dict, got {validate.shown(options)}.")
    unknown = sorted(set(map(str, options)) - {"state", "target"})
    if unknown:
        raise ValueError(f"Unknown reset options {unknown}. Known: ['state', 'target'].")
    state, target = options.get("state"), options.get("target")
    result = {}
    if state is not None:
        if not isinstance(state, Mapping) or not set(state) <= {"q", "v"}:
            raise ValueError(
                f"options['state'] must be a dict of 'q' and 'v', got {validate.shown(state)}."
            )
        for x in ("q", "v"):
            result[x] = _coordinates(f"options['state'][{x!r}]", state.get(x), arm.n, n_row)
    if target is not None:
        result["centre"] = _coordinates("options['target']", target, arm.n_joint, n_row)
    return result


def _coordinates(name: str, values: Any, size: int, n_row: int) -> Array:
    """(size,) numbers for all environments or (n_row, size), one row each; zeros for None."""
    if values is None:
        return np.zeros(size)
    try:
        rows = np.ndim(np.asarray(values, dtype=object))
    except (RuntimeError, TypeError) as error:  # of torch: with gradients, or on a GPU
        raise ValueError(f"{name} must be numbers of the processor: {error}") from None
    shape = (size,) if rows < 2 else (n_row, size)
    return validate.array(values, name, shape, FARTHEST_START)


def whole_seed(seed: Any) -> int | None:
    """Return a seed as a Python int, or None; NumPy integers are allowed."""
    if seed is None:
        return None
    return validate.integer(seed, "seed", 0, MOST_SEED)


def not_finite(actions: NDArray[np.float32]) -> ValueError:
    """Error for actions (N, n_torque) of which some are not finite."""
    bad = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
    return ValueError(
        f"Actions must be finite numbers (clipped to [-1, 1]), got {actions[bad].tolist()} for "
        f"environment {bad}."
    )


def too_bent(factor: float) -> ValueError:
    """Error for a placed state in which the model has no meaning."""
    return ValueError(
        f"options['state'] must bend no link by more than {factor:g} times the deflection_limit; "
        "the model of this arm is meaningless there."
    )
