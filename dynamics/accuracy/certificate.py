"""How far a model and its step are from the truth on a scene, by cause: measured, not promised."""

from dataclasses import dataclass, replace
from typing import Any

from dynamics.accuracy.fidelity import Fidelity, everything
from dynamics.accuracy.reference import Bench, apart
from dynamics.accuracy.rollout import Rollout
from dynamics.accuracy.scene import Scene
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import ArmSource, load_arm


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Measured errors of a model, an integrator and a step; the largest distance of the tip [m].

    error: of model and step together, from the reference. integration: of the step alone.
    truncation: of the modes kept, with their damping ratio, from more of them, with the viscosity
    that stands for it. nonlinear: of those, from the reference.
    residual: what the last refinement of the reference moved its tip by.
    """

    model: str
    integrator: str
    dt: float  # [s]
    error: float
    integration: float
    truncation: float
    nonlinear: float
    residual: float
    reach: float  # [m] of the arm, to compare
    cost: float  # operations per simulated second
    reference: str
    scene: str

    def to_dict(self) -> dict[str, Any]:
        """Numbers and text, as JSON holds them."""
        return dict(vars(self))


def certify(
    arm: ArmSource, scene: Scene, integrator: str, dt: float, accuracy: float
) -> Certificate:
    """Measure a model on a scene's motions.

    Parameters
    ----------
    arm : the model as it is stepped, modes included.
    integrator, dt : a method of INTEGRATORS and its step [s].
    accuracy : [m] to which the reference has to converge, and every motion free of its own steps
        by a fifth of it.

    Raises
    ------
    RuntimeError : naming numbers, if the reference does not converge that far.
    ValueError : for a scene that does not fit the arm.
    """
    arm = load_arm(arm)
    validate.instance(scene, "scene", Scene).check(arm)
    validate.known(integrator, "integrator", INTEGRATORS)
    validate.positive(dt, "dt", "s")
    bench = Bench(arm, scene, 10.0 * validate.positive(accuracy, "accuracy", "m"))
    reference = bench.converge()
    own = fidelity_of(arm)
    richer = replace(own, counts=everything(arm, 5, 3), polynomial=True)
    rollout = Rollout(arm)
    tips = bench.follow(rollout)
    traced = rollout.method(integrator)
    runs = [rollout.run(motion, integrator, dt) for motion in scene.motions]
    kept = [slice(None, None, run.stride) for run in runs]
    stepped = [run.tips for run in runs]
    settled = [x[k] for x, k in zip(tips, kept, strict=True)]
    truth = [x[k] for x, k in zip(bench.truth, kept, strict=True)]
    return Certificate(
        model=str(own),
        integrator=integrator,
        dt=dt,
        error=apart(stepped, truth),
        integration=apart(stepped, settled),
        truncation=apart(tips, bench.tips(richer)),
        nonlinear=bench.error(richer),
        residual=bench.residual,
        reach=arm.reach,
        cost=traced.evaluations * traced.operations / dt,
        reference=reference,
        scene=scene.name,
    )


def fidelity_of(arm: Arm) -> Fidelity:
    """What an arm keeps of its links, as `choose_model` would call it."""
    counts = tuple(
        (len(link.in_direction("y")), len(link.in_direction("z")), len(link.in_direction("x")))
        for link in arm.links
    )
    segments = tuple(link.segments for link in arm.links)
    return Fidelity(counts=counts, segments=segments, foreshortening=arm.foreshortening)
