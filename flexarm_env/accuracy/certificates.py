"""Stored certificates of the registered environments, and model selection by fidelity or tolerance.

`flexarm_env.certify` writes the certificates to certificates.json in this folder.
"""

import json
import logging
import math
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from dynamics import cache
from dynamics.accuracy.certificate import fidelity_of
from dynamics.accuracy.fidelity import Fidelity, divisible, everything, rigid
from dynamics.accuracy.model_choice import choose_model
from dynamics.accuracy.scene import JointMotion, Scene
from dynamics.backends.numba_llvm.fingerprint import fingerprint, hash_of_files, sources
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.load import load_arm
from dynamics.simulation.case_file import PiecewiseConstant, Torque
from flexarm_env.accuracy.episodes import RANDOM_SHARE, RANDOM_STEPS, keeps_tip
from flexarm_env.scales import RIGID_PERIOD, scales

_log = logging.getLogger(__name__)

STORE = Path(__file__).with_name("certificates.json")
PERIODS = 4.0  # length of the bang-bang motion, in periods of the first joint-free mode

FIDELITIES = ("rigid", "auto", "reference")
AUTO_TOLERANCE = 1e-3  # [of the reach] tip error of the model that `modes: auto` gives
REFERENCE_MODES = (3, 2)  # per segment: of bending, of torsion
REFERENCE_METHOD = "extrapolated-midpoint"


def scene(arm: Arm, control_dt: float) -> Scene:
    """Motions on which an arm is certified, from its home posture at rest.

    One is bang-bang at full torque, then coasting; the other has random torques. All torques are
    constant over a control step [s]: the period is rounded to whole steps.
    """
    found = scales(arm)
    limit = np.array(found.torque_limit)
    period = 2.0 * np.pi / found.free[0] if found.free else RIGID_PERIOD
    half = control_dt * max(1, round(0.5 * period / control_dt))
    waves = [PiecewiseConstant(times=(0.0, half, 2.0 * half), values=(u, -u, 0.0)) for u in limit]
    rng = np.random.default_rng(0)
    shares = rng.uniform(-RANDOM_SHARE, RANDOM_SHARE, (limit.size, RANDOM_STEPS))
    times = tuple((control_dt * np.arange(RANDOM_STEPS)).tolist())
    steps = [
        PiecewiseConstant(times=times, values=tuple((u * row).tolist()))
        for u, row in zip(limit, shares, strict=True)
    ]
    rest = (0.0,) * arm.n_joint
    motions = ((waves, 2.0 * PERIODS * half), (steps, control_dt * RANDOM_STEPS))
    return Scene(
        name=f"bang-bang and random torques, held for {control_dt:g} s",
        motions=tuple(
            JointMotion(
                joint_angles=found.home,
                joint_rates=rest,
                t_end=t_end,
                torque=Torque(signals=tuple(signals)),
                hold=control_dt,
            )
            for signals, t_end in motions
        ),
    )


@lru_cache(maxsize=1)
def stored() -> dict[str, dict[str, Any]]:
    """Contents of certificates.json: preset -> control_dt, steps, certificate."""
    text = STORE.read_text(encoding="utf-8") if STORE.exists() else "{}"
    result: dict[str, dict[str, Any]] = json.loads(text)
    return result


def kept(arm: Arm, control_dt: float) -> dict[str, Any] | None:
    """Stored entry of an arm with a control step [s]: `steps`, best first, and `certificate`.

    A step has integrator, substeps, its error over episodes [of the reach] and CPU time [s]. None
    if this arm and control step were not measured.
    """
    for name, entry in stored().items():
        if entry["control_dt"] == control_dt and load_arm(name) == arm:
            origin = {"reproduce": f"python -m flexarm_env.certify {name}"}
            return {**entry, "certificate": entry["certificate"] | origin}
    return None


def find(arm: Arm, control_dt: float, integrator: str, substeps: int) -> dict[str, Any] | None:
    """Stored certificate of this arm, integrator and step, or None."""
    entry = kept(arm, control_dt)
    if entry is None:
        return None
    certificate: dict[str, Any] = entry["certificate"]
    same = certificate["integrator"] == integrator and certificate["dt"] == control_dt / substeps
    return certificate if same else None


@dataclass(frozen=True)
class Fitted:
    """Model that an environment steps for a described arm."""

    arm: Arm
    integrator: str | None = None  # None: not chosen here
    substeps: int | None = None
    certificate: dict[str, Any] | None = None
    reason: str = ""  # of the choice for `modes: auto`


def fit(arm: Arm, control_dt: float, fidelity: str | Fidelity, tolerance: float | None) -> Fitted:
    """Model of an arm for a fidelity, one of FIDELITIES, or the cheapest within a tolerance [m].

    An arm with `modes: auto` takes the cheapest within AUTO_TOLERANCE. Where no model meets that,
    it keeps the modes of `mode_rule`, and a warning is logged.

    Raises
    ------
    ValueError : for an unknown fidelity, or a fidelity beside a tolerance.
    RuntimeError : if no model meets the tolerance, see `dynamics.choose_model`.
    """
    if isinstance(fidelity, Fidelity):
        return Fitted(fidelity.arm(arm), REFERENCE_METHOD)
    validate.known(fidelity, "fidelity", FIDELITIES)
    if tolerance is not None:
        if fidelity != "auto":
            raise ValueError(
                f"Give a tolerance ({validate.shown(tolerance)} m) or a fidelity, not both."
            )
        return _chosen(arm, control_dt, validate.positive(tolerance, "tolerance", "m"))
    if fidelity == "rigid":
        return Fitted(rigid(arm).arm(arm))
    if fidelity == "reference":
        return Fitted(reference(arm).arm(arm), REFERENCE_METHOD)
    return _automatic(arm, control_dt) if arm.automatic else Fitted(arm)


def reference(arm: Arm, finer: int = 0) -> Fidelity:
    """Fidelity of the reference: links in segments, `finer` more than usual.

    A single link, whose tip carries no other, condenses most of its inertia at its tip: it has
    four. Links that carry others are exact to 1e-5 of the reach with two.
    """
    flexible = [
        any(counts) and cut
        for counts, cut in zip(everything(arm, 1, 1), divisible(arm), strict=True)
    ]
    segments = (4 if sum(flexible) == 1 else 2) + finer
    return replace(
        rigid(arm, foreshortening=True, polynomial=True),
        counts=everything(arm, *REFERENCE_MODES),
        segments=tuple(segments if cut else 1 for cut in flexible),
    )


def _automatic(arm: Arm, control_dt: float) -> Fitted:
    """Model for `modes: auto`, chosen by measurement if that succeeds, else by rule."""
    name, tolerance = arm.name or "the arm", AUTO_TOLERANCE * arm.reach
    found = _choice(arm, control_dt, tolerance)
    if "failed" in found:
        reason = (
            f"No model was found within {tolerance:.3g} m ({found['failed']}) The modes are those "
            f"of the rule, {fidelity_of(arm)}, whose error is not known; list modes, or give a "
            "tolerance."
        )
        _log.warning("modes: auto of %s: %s", name, reason)
        return Fitted(arm.with_listed_modes(), reason=reason)
    _log.info("modes: auto of %s: %s", name, found["reason"])
    return replace(_fitted(found, control_dt), reason=found["reason"])


def _chosen(arm: Arm, control_dt: float, tolerance: float) -> Fitted:
    """Model that `choose_model` finds on the arm's `scene`."""
    found = _choice(arm, control_dt, tolerance)
    if "failed" in found:
        raise (ValueError if found["refused"] else RuntimeError)(found["failed"])
    return _fitted(found, control_dt)


def _fitted(found: dict[str, Any], control_dt: float) -> Fitted:
    """Model and step of a choice; a warning is logged if its links are rigid."""
    substeps = max(1, math.ceil(control_dt / found["dt"] - 1e-9))
    arm = load_arm(found["arm"])
    if fidelity_of(arm).rigid and any(link.stiffnesses for link in arm.links):
        _log.warning(
            "The chosen model of %s has rigid links: they keep the tip within %.2g m of the "
            "flexible reference, %.3g m are allowed; take a smaller tolerance for links that bend.",
            arm.name or "the arm", found["error"], found["tolerance"],
        )  # fmt: skip
    certificate = {key: value for key, value in found.items() if key != "arm"}
    return Fitted(arm, found["integrator"], substeps, certificate)


def _choice(arm: Arm, control_dt: float, tolerance: float) -> dict[str, Any]:
    """Result of `choose_model` on the arm's `scene`, or `failed` with the reason.

    It is cached, since the search may take minutes.
    """
    arm = arm.with_listed_modes()
    described = json.dumps(arm.to_dict())
    search = hash_of_files(sources(("accuracy", "simulation")))
    episodes = hash_of_files([Path(__file__).with_name("episodes.py")])
    key = fingerprint("choice", search, episodes, described, repr(control_dt), repr(tolerance))

    def choose() -> str:
        try:
            keeps = partial(keeps_tip, control_dt)
            found = choose_model(arm, scene(arm, control_dt), tolerance, acceptable=keeps).to_dict()
        except (RuntimeError, ValueError) as error:
            found = {"failed": str(error), "refused": isinstance(error, ValueError)}
        return json.dumps(found, indent=2)

    result: dict[str, Any] = json.loads(cache.kept(f"choice_{key}", choose))
    return result
