"""The fewest steps of each method that keep an environment's error, and the cheapest of these."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from dynamics.accuracy.model_choice import MOST_FROZEN
from dynamics.integrators.table import INTEGRATORS
from dynamics.types import Array
from flexarm_env.accuracy.motions import KINDS
from flexarm_env.accuracy.timing import cpu_seconds
from flexarm_env.certify.certificate import Certifier
from flexarm_env.certify.episodes import Distances
from flexarm_env.certify.momentum import momentum_error
from flexarm_env.core import Core
from flexarm_env.task.scales import SAFE, scales

METHODS = (
    "extrapolated-midpoint", "numerov", "rk4", "midpoint",
    "exponential-4", "exponential-3", "exponential-2", "exponential",
)  # fmt: skip
TIP_ERROR = 1e-3  # [of the reach] of model and step together, in SHARE of the episodes of a kind
MARGIN = 0.8  # of TIP_ERROR: other episodes scatter by as much
ALONE = 1.2  # [-] error with a step over that of the model, where this leaves no margin
SLACK, SHAKEN = 3.5, 12.0  # [-] the same at every time, where the model errs by more than TIP_ERROR
# SHAKEN where links vibrate from the start, which the model itself follows for long
PARTED = 1e-2  # [of the reach] error of the model beyond which no step is judged
MOMENTUM_ERROR = 1e-3  # [of the base's own momentum] that a step may lose on a floating base
MOST_STEPS = 24  # per control step; more than that is never the cheapest
MOST_WORK = 3.0  # evaluations over the fewest of the methods before
BATCH = 1024  # environments that are timed together
TIMED = 500  # timing rounds, a second of each method: the choice must not depend on disturbances
TIME_PER_DECADE = 0.1  # relative increase of CPU time that is accepted for a tenth of the error
EXACT = 1e-9  # [of the reach] errors below are alike: round-off, or none

Step = dict[str, Any]  # integrator, substeps, error [of the reach], seconds


class Limits:
    """Largest errors that a step may have, from those of the model itself.

    In kinds of episodes where the model keeps TIP_ERROR, so must the step: with a MARGIN for other
    draws, unless the worst of these kinds leaves none. Where the model does not, since motions grow
    apart in time, the error may be SLACK times the model's at every time, or SHAKEN times.
    """

    def __init__(self, certifier: Certifier) -> None:
        model, self.reach = certifier.model_error(), certifier.reach
        self.curve: dict[str, Array] = {}  # [of the reach] (T,)
        shares = {kind: model.share(kind) / self.reach for kind in dict.fromkeys(model.kinds)}
        kept = {kind: share for kind, share in shares.items() if share <= TIP_ERROR}
        worst = max(kept.values(), default=0.0)
        # [of the reach] by kind, over whole episodes
        self.share = dict.fromkeys(kept, min(TIP_ERROR, max(MARGIN * TIP_ERROR, ALONE * worst)))
        for kind in shares.keys() - kept.keys():
            curve = model.curve(kind) / self.reach
            allowed = np.maximum(TIP_ERROR, (SHAKEN if KINDS[kind].shaken else SLACK) * curve)
            self.curve[kind] = np.where(curve > PARTED, np.inf, allowed)

    def keep(self, found: Distances) -> bool:
        """True if errors over episodes stay within the limits."""
        whole = all(found.share(kind) <= most * self.reach for kind, most in self.share.items())
        return whole and not any(
            np.any(found.curve(kind) > allowed * self.reach) for kind, allowed in self.curve.items()
        )


def sufficient_steps(certifier: Certifier) -> list[Step]:
    """The fewest steps of each method that keep the error, unless they take far more work."""
    limits, found, fewest = Limits(certifier), [], math.inf
    for name in METHODS:
        method = INTEGRATORS[name]
        if method.aid == "modes" and certifier.model.n > MOST_FROZEN:
            continue
        step = fewest_steps(certifier, limits, name, MOST_WORK * fewest)
        if step:
            found.append(step)
            fewest = min(fewest, method.evaluations(step["substeps"]))
    return found


def fewest_steps(certifier: Certifier, limits: Limits, integrator: str, most: float) -> Step | None:
    """Step with the fewest stable and accurate substeps of a method.

    None above MOST_STEPS, or above `most` evaluations of the accelerations.
    """
    arm, control_dt, method = certifier.model, certifier.control_dt, INTEGRATORS[integrator]
    first = int(control_dt * scales(arm).fastest / (SAFE * method.limit)) + 1
    for substeps in range(first, MOST_STEPS + 1):
        if method.evaluations(substeps) > most:
            return None
        found = certifier.error(integrator, substeps)
        lost = momentum_error(certifier.arm, certifier.keywords, integrator, substeps)
        if limits.keep(found) and lost <= MOMENTUM_ERROR:
            error = found.worst_share / certifier.reach
            return {"integrator": integrator, "substeps": substeps, "error": float(f"{error:.3g}")}
    return None


def given_step(certifier: Certifier, integrator: str, substeps: int) -> Step:
    """A step of the user's choice; a ValueError if episodes diverge by it, not by the model."""
    error = certifier.error(integrator, substeps).worst_share / certifier.reach
    if not math.isfinite(error) and math.isfinite(certifier.model_error().worst_share):
        raise ValueError(
            f"{integrator!r} with {substeps} substeps diverges in these episodes; give more "
            "substeps, or leave both out."
        )
    return {"integrator": integrator, "substeps": substeps, "error": float(f"{error:.3g}")}


def timed(certifier: Certifier, steps: list[Step]) -> list[Step]:
    """The steps with `seconds` added: CPU time per control step of one environment in a batch."""
    calls = {}
    for k, step in enumerate(steps):
        core = _batch(certifier.keywords | {key: step[key] for key in ("integrator", "substeps")},
                      certifier)  # fmt: skip
        core.reset(np.arange(BATCH))
        calls[k] = partial(core.step, np.zeros((BATCH, len(core.torque_limit)), np.float32))
    seconds = cpu_seconds(calls, TIMED)
    return [{**step, "seconds": seconds[k] / BATCH} for k, step in enumerate(steps)]


def _batch(keywords: Mapping[str, Any], certifier: Certifier) -> Core:
    return Core(task="Reach", arm=certifier.arm, n_env=BATCH, **keywords)


def best_first(steps: list[Step]) -> list[Step]:
    """Sort by CPU time, corrected for the error by TIME_PER_DECADE."""

    def cost(step: Step) -> float:
        return math.log(step["seconds"]) + TIME_PER_DECADE * math.log10(max(EXACT, step["error"]))

    return sorted(steps, key=cost)
