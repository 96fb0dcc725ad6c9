"""Motions over which an environment is certified: actions of whole episodes, by kind.

Actions are shares of the torque that motion has at full torque; against gravity the torque that
holds the arm at its start is added. Times are in periods of the first joint-free mode, so that one
kind is as hard for every arm.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.types import Array

Actions = Callable[[Any, tuple[int, int, int], float], Array]


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of motion."""

    text: str  # for the pages
    actions: Actions | None  # (generator, (steps, episodes, torques), control step [periods])
    shaken: bool = False  # links vibrate at the start, as in Damp


def white(rng: Any, shape: tuple[int, int, int], step: float) -> Array:
    """Uniform numbers, new at every control step."""
    result: Array = rng.uniform(-1.0, 1.0, shape)
    return result


def held(rng: Any, shape: tuple[int, int, int], step: float) -> Array:
    """Uniform numbers, each held for HOLD periods."""
    return _repeated(rng.uniform(-1.0, 1.0, _draws(shape, HOLD / step)), shape, HOLD / step)


def bang_bang(rng: Any, shape: tuple[int, int, int], step: float) -> Array:
    """Full torque of random sign, each held for BANG periods."""
    signs = rng.choice([-1.0, 1.0], _draws(shape, BANG / step))
    return _repeated(signs, shape, BANG / step)


def sines(rng: Any, shape: tuple[int, int, int], step: float) -> Array:
    """Full sine waves of random frequency and phase, one per torque."""
    frequency = np.exp(rng.uniform(*np.log(SWEPT), shape[1:]))
    phase = rng.uniform(0.0, 2.0 * np.pi, shape[1:])
    time = step * np.arange(shape[0])[:, None, None]
    result: Array = np.sin(2.0 * np.pi * frequency * time + phase)
    return result


HOLD = 1.5  # [periods of the first joint-free mode]
BANG = 2.25  # [periods]
SWEPT = (1.0 / 15.0, 1.6)  # [-] range of the sines' frequencies over the first joint-free one
KINDS = {
    "white": Kind(text="uniform torques, new at every control step", actions=white),
    "held": Kind(text=f"uniform torques, held for {HOLD:g} periods", actions=held),
    "bang-bang": Kind(
        text=f"full torques of random sign, held for {BANG:g} periods", actions=bang_bang
    ),
    "sines": Kind(
        text=f"full sine waves of {SWEPT[0]:.2g} to {SWEPT[1]:g} times the first frequency",
        actions=sines,
    ),
    "shaken": Kind(
        text="links that vibrate as at the start of Damp, under held torques", actions=held,
        shaken=True,
    ),
    "classical": Kind(
        text="torques recorded in Reach from the best classical controller of the ranking, where "
        "the arm and its torque limits have one", actions=None,
    ),
    "learned": Kind(text="the same from the best learned controller", actions=None),
}  # fmt: skip
RECORDED = (
    Path(__file__).parents[1] / "certify" / "recorded"
)  # by `python -m agents.leaderboard.recorded`
AGILE = "-agile"  # ends the name of a recording at agile torques
LEVELS = 127  # of a recorded action, from 0 to 1


@dataclass(frozen=True)
class Recorded:
    """Episodes of a controller at an arm's own torque limits."""

    start: Array  # (N, n_joint) [rad], at rest
    actions: Array  # (T, N, n_torque)


def recorded(arm: str, torque_limit: Array) -> dict[str, Recorded]:
    """Recorded episodes by kind, for the name of an arm and its torque limits [N m]."""
    for path in sorted(RECORDED.glob("*.npz")):
        if path.stem not in (arm, f"{arm}{AGILE}"):
            continue
        with np.load(path) as file:
            limit = file["torque_limit"]
            if limit.shape == torque_limit.shape and np.allclose(limit, torque_limit):
                return {
                    kind: Recorded(file[f"{kind}_start"], file[f"{kind}_actions"] / LEVELS)
                    for kind in ("classical", "learned")
                    if f"{kind}_start" in file
                }
    return {}


def _steps(duration: float) -> int:
    return max(1, round(duration))


def _draws(shape: tuple[int, int, int], duration: float) -> tuple[int, int, int]:
    """Shape of the numbers that are held for a duration [control steps]."""
    return (-(-shape[0] // _steps(duration)), *shape[1:])


def _repeated(values: Array, shape: tuple[int, int, int], duration: float) -> Array:
    result: Array = np.repeat(values, _steps(duration), axis=0)[: shape[0]]
    return result
