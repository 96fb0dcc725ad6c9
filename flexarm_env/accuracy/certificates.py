"""Stored certificates of the registered environments, and model selection by fidelity or tolerance.

`flexarm_env.certify` writes the certificates to certificates.json in this folder.
"""

import json
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from dynamics import cache
from dynamics.accuracy.choice import NoModel
from dynamics.accuracy.fidelity import Fidelity, divisible, everything, fidelity_of, rigid
from dynamics.backends.numba_llvm.fingerprint import fingerprint, hash_of_files, sources
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.load import load_arm
from dynamics.runtime.jit import check_compiler
from flexarm_env.accuracy.conditions import Conditions

Entry = dict[str, Any]  # steps, certificate
Chooser = Callable[[Arm, float, float], dict[str, Any]]
_log = logging.getLogger(__name__)

STORE = Path(__file__).with_name("certificates.json")
FIDELITIES = ("rigid", "auto", "reference")
AUTO_TOLERANCE = 1e-3  # [of the reach] tip error of the model that `modes: auto` gives
REFERENCE_MODES = (3, 2)  # per segment: of bending, of torsion
REFERENCE_METHOD = "extrapolated-midpoint"
MEASURING = ("accuracy", "certify", "compiled", "hardware", "task")  # rooms that play episodes
_chooser: list[Chooser] = []


def choose_by(chooser: Chooser) -> None:
    """Set the search for `tolerance` and `modes: auto`, which plays environments."""
    _chooser[:] = [chooser]


@lru_cache(maxsize=1)
def stored() -> dict[str, dict[str, Any]]:
    """Contents of certificates.json: preset -> control_dt, and `measured` by conditions."""
    text = STORE.read_text(encoding="utf-8") if STORE.exists() else "{}"
    result: dict[str, dict[str, Any]] = json.loads(text)
    return result


def entries(arm: Arm, control_dt: float) -> list[Entry]:
    """Entries of an arm and a control step [s], one for each set of conditions.

    An entry has `steps`, best first, and `certificate`, the errors of the best. A step has
    integrator, substeps, its error over episodes [of the reach] and CPU time [s].
    """
    found: list[Entry] = []
    for name, entry in stored().items():
        if entry["control_dt"] == control_dt and load_arm(name) == arm:
            found += entry["measured"]
    return found + own_entries(arm, control_dt)


def own_entries(arm: Arm, control_dt: float) -> list[Entry]:
    """Entries that `flexarm certify` left in the user's cache."""
    text = cache.load(_name(arm, control_dt))
    return json.loads(text) if text else []


def keep(arm: Arm, control_dt: float, entry: Entry) -> None:
    """Keep an entry in the user's cache, in place of one of the same conditions."""
    holds = entry["certificate"]["holds"]
    others = [x for x in own_entries(arm, control_dt) if x["certificate"]["holds"] != holds]
    cache.store(_name(arm, control_dt), json.dumps([*others, entry], indent=2).encode())


def _name(arm: Arm, control_dt: float) -> str:
    described = json.dumps(arm.to_dict())
    return "certificates_" + fingerprint("certificates", _measuring(), described, repr(control_dt))


@lru_cache(maxsize=1)
def _measuring() -> str:
    """Hash of the sources that measure errors."""
    package = Path(__file__).parents[1]
    own = [path for room in MEASURING for path in (package / room).rglob("*.py")]
    return hash_of_files([*sources(("accuracy", "simulation")), *own])


def covering(measured: Sequence[Entry], conditions: Conditions) -> Entry | None:
    """First entry whose conditions cover those of an environment, of plants drawn alike if any."""
    found = []
    for entry in measured:
        known = Conditions.from_dict(entry["certificate"]["holds"])
        if not conditions.beyond(known):
            found.append((conditions.part(known) is not None, entry))
    return min(found, key=lambda x: x[0])[1] if found else None


def alike(measured: Sequence[Entry], conditions: Conditions) -> Entry | None:
    """First entry of such conditions, whose steps are the best guess where none covers them."""
    for entry in measured:
        known = Conditions.from_dict(entry["certificate"]["holds"])
        if known.actuators == conditions.actuators and (
            bool(known.ranges) == bool(conditions.ranges)
        ):
            return entry
    return None


def by_step(
    certificate: Mapping[str, Any], control_dt: float, integrator: str, substeps: int
) -> bool:
    """True if a certificate is of this step."""
    same = math.isclose(certificate["dt"], control_dt / substeps, rel_tol=1e-9)
    return same and certificate["integrator"] == integrator


@dataclass(frozen=True)
class Fitted:
    """Model that an environment steps for a described arm."""

    arm: Arm
    integrator: str | None = None  # None: not chosen here
    entry: Entry | None = None  # of a model that was chosen by measurement
    reason: str = ""  # of the choice for `modes: auto`


def fit(arm: Arm, control_dt: float, fidelity: str | Fidelity, tolerance: float | None) -> Fitted:
    """Model of an arm for a fidelity, one of FIDELITIES, or the cheapest within a tolerance [m].

    An arm with `modes: auto` takes the cheapest within AUTO_TOLERANCE. Where no model meets that,
    it keeps the modes of `mode_rule`, and a warning is logged.

    Raises
    ------
    ValueError : for an unknown fidelity, or a fidelity beside a tolerance.
    NoModel : if no model meets the tolerance, see `dynamics.choose_model`.
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
    """Model that is found over episodes."""
    found = _choice(arm, control_dt, tolerance)
    if "failed" in found:
        raise (ValueError if found["refused"] else NoModel)(found["failed"])
    return _fitted(found, control_dt)


def _fitted(found: dict[str, Any], control_dt: float) -> Fitted:
    """Model and step of a choice; a warning is logged if its links are rigid."""
    arm = load_arm(found["arm"])
    if fidelity_of(arm).rigid and any(link.stiffnesses for link in arm.links):
        _log.warning(
            "The chosen model of %s has rigid links: they keep the tip within %.2g m of the "
            "flexible reference, at a tolerance of %.3g m; take a smaller one for links that bend.",
            arm.name or "the arm", found["error"], found["tolerance"],
        )  # fmt: skip
    certificate = {key: value for key, value in found.items() if key != "arm"}
    substeps = max(1, math.ceil(control_dt / found["dt"] - 1e-9))
    step = {"integrator": found["integrator"], "substeps": substeps}
    return Fitted(arm, entry={"steps": [step], "certificate": certificate})


def _choice(arm: Arm, control_dt: float, tolerance: float) -> dict[str, Any]:
    """Result of `certify.choice.chosen`, or `failed` with the reason.

    It is cached, since the search may take minutes.
    """
    described = json.dumps(arm.to_dict())
    key = fingerprint("choice", _measuring(), described, repr(control_dt), repr(tolerance))

    def choose() -> str:
        check_compiler()
        try:
            found = _chooser[0](arm, control_dt, tolerance)
        except (NoModel, ValueError) as error:
            found = {"failed": str(error), "refused": isinstance(error, ValueError)}
        return json.dumps(found, indent=2)

    result: dict[str, Any] = json.loads(cache.kept(f"choice_{key}", choose))
    return result
