"""How true an environment is, and models as true as one asks for.

The registered environments' certificates are kept in certificates.json; certify.py makes them.
"""

import json
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from dynamics import cache
from dynamics.accuracy.fidelity import everything, rigid
from dynamics.accuracy.model_choice import choose_model
from dynamics.accuracy.scene import JointMotion, Scene
from dynamics.backends.numba_llvm.program import fingerprint, hash_of_files, sources
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.load import load_arm
from dynamics.simulation.case_file import PiecewiseConstant, Torque
from flexarm_env.scales import scales

STORE = Path(__file__).with_name("certificates.json")
RANDOM_STEPS = 40  # control steps of random torque
RANDOM_SHARE = 0.4  # of full torque, at most
PERIODS = 4.0  # of the first joint-free mode, in the bang-bang motion
RIGID_PERIOD = 0.5  # [s] instead, for an arm without modes
_CHOOSING = hash_of_files(sources(("accuracy", "simulation")))
FIDELITIES = ("rigid", "auto", "reference")
REFERENCE_MODES, REFERENCE_SEGMENTS = 3, 2  # per direction of bending; per flexible link


def scene(arm: Arm, control_dt: float) -> Scene:
    """Motions as an arm's environments make them, from its home posture at rest."""
    found = scales(arm)
    limit = np.array(found.torque_limit)
    period = 2.0 * np.pi / found.free[0] if found.free else RIGID_PERIOD
    waves = [
        PiecewiseConstant(times=(0.0, 0.5 * period, period), values=(u, -u, 0.0)) for u in limit
    ]
    rng = np.random.default_rng(0)
    shares = rng.uniform(-RANDOM_SHARE, RANDOM_SHARE, (limit.size, RANDOM_STEPS))
    times = tuple((control_dt * np.arange(RANDOM_STEPS)).tolist())
    held = [
        PiecewiseConstant(times=times, values=tuple((u * row).tolist()))
        for u, row in zip(limit, shares, strict=True)
    ]
    rest = (0.0,) * arm.n_joint
    return Scene(
        name=f"bang-bang and random torques, held for {control_dt:g} s",
        motions=tuple(
            JointMotion(
                joint_angles=found.home,
                joint_rates=rest,
                t_end=t_end,
                torque=Torque(signals=tuple(signals)),
            )
            for signals, t_end in ((waves, PERIODS * period), (held, control_dt * RANDOM_STEPS))
        ),
    )


@lru_cache(maxsize=1)
def stored() -> dict[str, dict[str, Any]]:
    """All kept certificates: preset -> control_dt, certificate."""
    text = STORE.read_text(encoding="utf-8") if STORE.exists() else "{}"
    result: dict[str, dict[str, Any]] = json.loads(text)
    return result


def kept(arm: Arm, control_dt: float) -> dict[str, Any] | None:
    """What is kept of an arm at a control step: the measured `steps`, best first, a `certificate`.

    A step holds integrator, substeps, its error over episodes [of the reach] and CPU time [s].
    """
    for name, entry in stored().items():
        if entry["control_dt"] == control_dt and load_arm(name) == arm:
            origin = {"reproduce": f"python -m flexarm_env.certify {name}"}
            return {**entry, "certificate": entry["certificate"] | origin}
    return None


def find(arm: Arm, control_dt: float, integrator: str, substeps: int) -> dict[str, Any] | None:
    """The kept certificate of just this arm and step, or None."""
    entry = kept(arm, control_dt)
    if entry is None:
        return None
    certificate: dict[str, Any] = entry["certificate"]
    same = certificate["integrator"] == integrator and certificate["dt"] == control_dt / substeps
    return certificate if same else None


@dataclass(frozen=True)
class Fitted:
    """What an environment steps in place of the arm it was given."""

    arm: Arm
    integrator: str | None = None  # None: chosen for the arm
    substeps: int | None = None
    certificate: dict[str, Any] | None = None


def fit(arm: Arm, control_dt: float, fidelity: str, tolerance: float | None) -> Fitted:
    """The model for a fidelity of FIDELITIES, or the cheapest within a tolerance [m].

    Raises
    ------
    ValueError : for an unknown fidelity, or one beside a tolerance.
    RuntimeError : if no model is that true, see `dynamics.choose_model`.
    """
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
        counts = everything(arm, REFERENCE_MODES, 2)
        cut = tuple(REFERENCE_SEGMENTS if any(count) else 1 for count in counts)
        fine = replace(rigid(arm, foreshortening=True, polynomial=True), counts=counts)
        return Fitted(replace(fine, segments=cut).arm(arm), "midpoint")  # stiff and damped
    return Fitted(arm)


def _chosen(arm: Arm, control_dt: float, tolerance: float) -> Fitted:
    """What `choose_model` finds for the environment's motions; kept, since it may take minutes."""
    described = json.dumps(arm.to_dict())
    key = fingerprint("choice", _CHOOSING, described, repr(control_dt), repr(tolerance))

    def choose() -> str:
        return json.dumps(choose_model(arm, scene(arm, control_dt), tolerance).to_dict(), indent=2)

    found = json.loads(cache.kept(f"choice_{key}", choose))
    substeps = max(1, math.ceil(control_dt / found["dt"] - 1e-9))
    return Fitted(load_arm(found.pop("arm")), found["integrator"], substeps, found)
