"""The cheapest model and step that keep the tip within a tolerance in whole episodes.

`dynamics.choose_model` compares models on two short motions, without compiling them. Its choice
plays whole episodes beside the reference; where it errs by more, the search is made again for less,
unless the searches that are left cannot come to the tolerance: motions of arms of many links grow
apart in time, whatever the model.
"""

import logging
import math
from dataclasses import replace
from typing import Any

from dynamics.accuracy.choice import NoModel
from dynamics.accuracy.model_choice import choose_model
from dynamics.description.arm import Arm
from dynamics.description.link import Link
from dynamics.description.mode_rule import ModesByRule
from dynamics.description.mode_shapes import STIFFNESS
from dynamics.formulations.damping import yields
from dynamics.load import load_arm
from dynamics.progress import Progress
from flexarm_env.accuracy.certificates import reference
from flexarm_env.accuracy.motions import KINDS
from flexarm_env.accuracy.scene import scene
from flexarm_env.certify.certificate import DISTURBANCE, Certifier, summary
from flexarm_env.certify.episodes import SHARE, Distances
from flexarm_env.certify.search import ALONE
from flexarm_env.registration import SCENES

EPISODES = 16  # of each kind
LENGTH = max(steps for *_, steps in SCENES.values())  # control steps: errors grow with them
SEARCHES = 3
MORE = 3  # times the steps of the search, tried before another search
MARGIN = 0.8  # of the tolerance that a new search aims at
FAR = 0.1  # [reach] error from which motions are lost, and a smaller tolerance helps no more
LEAST = 0.1  # of a search's tolerance to that of the one before, MARGIN aside
_log = logging.getLogger(__name__)


def chosen(arm: Arm, control_dt: float, tolerance: float) -> dict[str, Any]:
    """JSON values of a `dynamics.Choice` whose error [m] is that of whole episodes.

    A link that states no modes beside links that have some stays rigid. The search compares with a
    reference that is rigid there too; the error of its choice is from one that bends there.

    Raises
    ------
    ValueError, NoModel : if `dynamics.choose_model` finds nothing on the short motions.
    """
    rigid = _rigid_as_stated(arm)
    stiff = tuple(_rigid(x) if k in rigid else x for k, x in enumerate(arm.links))
    found = _searched(replace(arm, links=stiff).with_listed_modes(), control_dt, tolerance)
    return _as_described(found, arm, rigid, control_dt, tolerance) if rigid else found


def _rigid_as_stated(arm: Arm) -> list[int]:
    """Links with a stiffness that state no modes, of an arm in which others have some."""
    states = [isinstance(link.modes, ModesByRule) or bool(link.modes) for link in arm.links]
    bends = [any(yields(link, direction) for direction in "yzx") for link in arm.links]
    return [k for k in range(len(states)) if any(states) and bends[k] and not states[k]]


def _rigid(link: Link) -> Link:
    """The link without stiffnesses."""
    none: dict[str, Any] = dict.fromkeys(STIFFNESS.values())
    if link.sections:
        return replace(link, sections=tuple(replace(x, **none) for x in link.sections))
    return replace(link, **none)


def _as_described(
    found: dict[str, Any], arm: Arm, rigid: list[int], control_dt: float, tolerance: float
) -> dict[str, Any]:
    """A choice whose `rigid` links have their stiffnesses again, measured in episodes as such."""
    model = load_arm(found["arm"])
    links = tuple(arm.links[k] if k in rigid else link for k, link in enumerate(model.links))
    model = replace(model, links=links)
    with Progress(None) as line:
        own = _in_episodes(found | {"arm": model.to_dict()}, control_dt, tolerance, line)
    reason = (
        f"{found['reason']} Rigid in that reference too, by modes: []: link "
        f"{', '.join(str(k + 1) for k in rigid)}. In whole episodes the tip stays within "
        f"{found['error']:.2g} m of it, and within {own['error']:.2g} m of one that bends there."
    )
    changed = {"arm": model.to_dict(), "reason": reason, "reference": str(reference(model))}
    return {**found, **own, **changed}


def _searched(arm: Arm, control_dt: float, tolerance: float) -> dict[str, Any]:
    """The choice for an arm with listed modes.

    A warning is logged if the best that was found errs by more than the tolerance.
    """
    motions, conditions = scene(arm, control_dt)
    wanted, best = tolerance, {"error": math.inf}
    for search in range(SEARCHES):
        try:
            found = choose_model(arm, motions, wanted).to_dict()
        except NoModel:
            if search == 0:
                raise
            break
        with Progress(None) as line:
            measured = _in_episodes(found, control_dt, tolerance, line)
        best = min(best, found | measured, key=lambda x: x["error"])
        left = (MARGIN * LEAST) ** (SEARCHES - 1 - search)  # of the error after all searches
        if tolerance >= best["error"] or tolerance < left * measured["error"] < math.inf:
            break
        wanted *= MARGIN * min(1.0, max(LEAST, tolerance / measured["error"]))
    if math.isinf(best["error"]):
        raise NoModel(
            "Every model that keeps the tolerance on short motions diverges in whole episodes."
        )
    if best["error"] > tolerance:
        remedy = "A smaller tolerance gives a finer model."
        if best["error"] > FAR * arm.reach:
            remedy = (
                "Errors grow to the size of the arm in its motions; Arm.with_listed_modes() keeps "
                "the modes by rule, without a search."
            )
        _log.warning(
            "No model of %s was found that keeps the tip within %.3g m in whole episodes; the best "
            "keeps %.0f %% of them within %.2g m. %s",
            arm.name or "the arm", tolerance, 100 * SHARE, best["error"], remedy,
        )  # fmt: skip
    return best | {"tolerance": tolerance, "holds": conditions.to_dict()}


def _in_episodes(
    found: dict[str, Any], control_dt: float, tolerance: float, line: Progress
) -> dict[str, Any]:
    """The fewest steps of a chosen model that keep a tolerance, and its errors with these.

    Where the model itself misses the tolerance, steps that add little to its error.
    """
    arm = load_arm(found["arm"])
    kinds = [name for name, kind in KINDS.items() if kind.actions]
    certifier = Certifier(arm, {"control_dt": control_dt}, LENGTH, line, kinds, EPISODES)
    least = max(1, math.ceil(control_dt / found["dt"] - 1e-9))
    model = certifier.model_error().worst_share
    stride = 1 if model <= tolerance else least
    for substeps in range(least, MORE * least + 1, stride):
        own = certifier.trace(found["integrator"], substeps)
        total = Distances.between(own, certifier.reference, certifier.episodes.kinds)
        if total.worst_share <= max(tolerance, ALONE * model):
            break
    nudged = certifier.trace(found["integrator"], substeps, DISTURBANCE)
    growth = Distances.between(own, nudged, total.kinds)
    return {
        "dt": control_dt / substeps,
        "error": total.worst_share,
        "scene": f"{SHARE:.0%} of {EPISODES} whole episodes of each kind",
        "episodes": summary(total, growth, control_dt, arm.reach),
    }
