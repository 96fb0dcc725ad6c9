"""Measured tip errors of a model and its step on a scene, separated by cause."""

from dataclasses import dataclass, replace
from typing import Any

from dynamics.accuracy.fidelity import DIRECTIONS, Fidelity, everything
from dynamics.accuracy.progress import Progress
from dynamics.accuracy.reference import ModelErrors, largest_distance
from dynamics.accuracy.rollout import Rollout
from dynamics.accuracy.scene import Scene
from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import ArmSource, load_arm


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Tip errors [m] of a model with an integrator and a step: largest over time and motions.

    The rich model is this model with five bending and three torsion modes per link.
    """

    model: str
    integrator: str
    dt: float  # [s]
    error: float  # model and step together, from the reference
    integration: float  # the step alone, from converged integration of this model
    truncation: float  # this model from the rich one, both with converged integration
    nonlinear: float  # the rich model from the reference
    residual: float  # tip displacement by the last refinement of the reference
    reach: float  # [m] of the arm, for comparison
    cost: float  # operations per simulated second
    reference: str
    scene: str

    def to_dict(self) -> dict[str, Any]:
        """Fields as JSON numbers and text."""
        return dict(vars(self))


def certify(
    arm: ArmSource,
    scene: Scene,
    integrator: str,
    dt: float,
    accuracy: float,
    *,
    progress: bool | None = None,
) -> Certificate:
    """Measure the errors of a model on a scene's motions.

    Parameters
    ----------
    arm : the model as it is stepped, modes included.
    integrator, dt : a method of INTEGRATORS and its step [s].
    accuracy : [m] residual allowed in the reference; a fifth of it is allowed as integration
        error in every converged motion.
    progress : True shows a line of progress on standard error; None only on a terminal.

    Raises
    ------
    RuntimeError : if the reference does not converge; the message states the residual.
    ValueError : for a scene that does not fit the arm.
    """
    accuracy = validate.positive(accuracy, "accuracy", "m")
    validate.known(integrator, "integrator", INTEGRATORS)
    validate.positive(dt, "dt", "s")
    with Progress(progress) as line:
        return Certifier(arm, scene, accuracy, line).certificate(integrator, dt)


class Certifier:
    """Errors of one model on a scene by any method and step, all from one reference.

    The arguments are those of `certify`, but for a line of progress.
    """

    def __init__(
        self, arm: ArmSource, scene: Scene, accuracy: float, line: Progress | None = None
    ) -> None:
        self.arm = load_arm(arm)
        validate.instance(scene, "scene", Scene).check(self.arm)
        self._errors = ModelErrors(self.arm, scene, 10.0 * accuracy, line)
        self._described = self._errors.converge()
        self._rollout = Rollout(self.arm)
        self._tips = self._errors.tips_of(self._rollout)
        self._errors.progress.stage("steps")

    @property
    def model_error(self) -> float:
        """[m] of the model, with converged integration."""
        return largest_distance(self._tips, self._errors.reference)

    def error(self, integrator: str, dt: float) -> float:
        """[m] of model and step together."""
        return self._distances(integrator, dt)[0]

    def certificate(self, integrator: str, dt: float) -> Certificate:
        """Errors of the model with a step, separated by cause."""
        errors, motions = self._errors, self._errors.scene.motions
        own = fidelity_of(self.arm)
        rich = replace(own, counts=everything(self.arm, 5, 3), polynomial=True, lumped=False)
        error, integration = self._distances(integrator, dt)
        return Certificate(
            model=str(own),
            integrator=integrator,
            dt=dt,
            error=error,
            integration=integration,
            truncation=largest_distance(self._tips, errors.tips(rich)),
            nonlinear=errors.error(rich),
            residual=errors.residual,
            reach=self.arm.reach,
            cost=max(self._rollout.cost(motion, integrator, dt) for motion in motions),
            reference=self._described,
            scene=errors.scene.name,
        )

    def _distances(self, integrator: str, dt: float) -> tuple[float, float]:
        """[m] of a run from the reference, and from the model's converged motion."""
        for motion in self._errors.scene.motions:
            if motion.hold and abs(motion.hold / dt - round(motion.hold / dt)) > 1e-6:
                raise ValueError(
                    f"dt ({dt:g} s) must divide JointMotion.hold ({motion.hold:g} s), the time for "
                    "which a torque is held."
                )
        motions = self._errors.scene.motions
        runs = [self._rollout.run(motion, integrator, dt) for motion in motions]
        self._errors.progress.motion()
        samples = [slice(None, None, run.stride) for run in runs]
        stepped = [run.tips for run in runs]
        converged = [x[k] for x, k in zip(self._tips, samples, strict=True)]
        true = [x[k] for x, k in zip(self._errors.reference, samples, strict=True)]
        return largest_distance(stepped, true), largest_distance(stepped, converged)


def fidelity_of(arm: Arm) -> Fidelity:
    """Fidelity of an arm as described, in the terms of `choose_model`."""
    counts = tuple(
        tuple(len(link.in_direction(d)) for d in DIRECTIONS[: len(possible)])
        for link, possible in zip(arm.links, everything(arm, 1, 1), strict=True)
    )
    segments = tuple(link.segments for link in arm.links)
    bending = [link for link in arm.links if link.modes]
    return Fidelity(
        counts=counts,
        segments=segments,
        foreshortening=bool(arm.foreshortening),
        lumped=bool(bending) and all(link.lumped for link in bending),
    )
