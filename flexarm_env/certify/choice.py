"""The cheapest model of an arm for an environment: `dynamics.choose_model` over whole episodes."""

import math
from collections.abc import Iterator

from dynamics.accuracy.choice import Choice, Rung
from dynamics.accuracy.fidelity import Fidelity
from dynamics.accuracy.model_choice import STEPPING, Step, search
from dynamics.accuracy.progress import Progress
from dynamics.accuracy.reference import MODEL_SHARE, REFERENCE_SHARE
from dynamics.accuracy.rollout import ESTIMATE
from dynamics.description.arm import Arm
from dynamics.integrators.table import INTEGRATORS
from flexarm_env.accuracy.certificates import REFERENCE_METHOD as METHOD
from flexarm_env.accuracy.certificates import reference
from flexarm_env.certify.certificate import WIDER, converged_steps
from flexarm_env.certify.episodes import SHARE, Distances, Episodes, Trace, environment
from flexarm_env.certify.motions import KINDS
from flexarm_env.core import Core
from flexarm_env.scales import DEFLECTION_LIMIT, SAFE, scales

EPISODES = 24  # of each kind
SECONDS_OF = 150  # control steps of an episode
MOST_STEPS = 64  # per control step
GROWTH = 1.3  # of the substeps that are tried


def choose(arm: Arm, control_dt: float, tolerance: float) -> tuple[Choice, Core]:
    """The cheapest model and step whose tip error [m] stays within a tolerance in episodes.

    The error is that of `certificate`: that of 95 of 100 episodes of the worst kind. Returns an
    environment of the choice too.

    Raises
    ------
    RuntimeError : if the reference does not converge, or no model or step is accurate enough.
    """
    with Progress(None) as line:
        errors = EpisodeErrors(arm, control_dt, tolerance, line)
        found = search(errors)
        return found, errors.first


class EpisodeErrors:
    """Tip errors over whole episodes at the arm's own torque limits; see `model_choice.Errors`."""

    def __init__(self, arm: Arm, control_dt: float, tolerance: float, line: Progress) -> None:
        self.arm, self.control_dt, self.tolerance, self.progress = arm, control_dt, tolerance, line
        self.first = environment(arm, 1, {"control_dt": control_dt})
        self.episodes = Episodes.drawn(self.first, tuple(KINDS), EPISODES, SECONDS_OF)
        self.name = f"{SHARE:.0%} of {EPISODES} episodes of each kind, held for {control_dt:g} s"
        self.residual = 0.0
        self._fine = converged_steps(arm, control_dt)
        self._traces: dict[Fidelity, Trace] = {}
        self._reference = reference(arm)

    @property
    def model_tolerance(self) -> float:
        """[m] error allowed in a model with fine steps."""
        return MODEL_SHARE * (self.tolerance - self.residual)

    def converge(self) -> str:
        """Compute the reference, and its distance from a finer one with half the step."""
        self.progress.stage("reference")
        finer = self._played(reference(self.arm, finer=1), METHOD, 2 * self._fine)
        self.residual = self._between(self._trace(self._reference), finer)
        if self.residual > REFERENCE_SHARE * self.tolerance:
            raise RuntimeError(
                f"The reference does not converge: '{self._reference}' is {self.residual:.3g} m "
                f"from a finer one; a tolerance of {self.tolerance:.3g} m needs "
                f"{REFERENCE_SHARE * self.tolerance:.3g} m. Take a larger tolerance."
            )
        self.progress.stage("models")
        return f"{self._reference}; its last refinement moved the tip by {self.residual:.2g} m"

    def error(self, fidelity: Fidelity) -> float:
        """[m] distance of a model, with fine steps, from the reference."""
        return self.apart(fidelity, self._reference)

    def apart(self, fidelity: Fidelity, other: Fidelity) -> float:
        """[m] distance of two models with fine steps."""
        return self._between(self._trace(fidelity), self._trace(other))

    def step_budget(self, fidelity: Fidelity) -> float:
        """[m] share of the tolerance that a model leaves for its integration error."""
        return self.tolerance - self.residual - self.error(fidelity)

    def operations(self, fidelity: Fidelity) -> int:
        """Operations of an evaluation of the accelerations."""
        return int(self._core(fidelity, "midpoint", 1, 1).program.OPERATIONS)

    def estimate(self, fidelity: Fidelity) -> float:
        """The same without a trace, to put models in order."""
        return sum(
            ESTIMATE * segments * (1 + sum(counts)) ** 2
            for counts, segments in zip(fidelity.counts, fidelity.segments, strict=True)
        )

    def steps(self, fidelity: Fidelity, cheapest: float) -> Iterator[Step]:
        """For each integrator the fewest steps within the tolerance, unless they exceed a cost."""
        arm = fidelity.arm(self.arm)
        for name in STEPPING:
            method = INTEGRATORS[name]
            count = int(self.control_dt * scales(arm).fastest / (SAFE * method.limit)) + 1
            while True:
                core = self._core(fidelity, name, count, len(self.episodes.kinds))
                error = self._between(self.episodes.played(core), self._trace(self._reference))
                self.progress.motion()
                operations = int(core.program.OPERATIONS)
                work = method.evaluations(count) * operations / self.control_dt
                fits = error + self.residual <= self.tolerance
                if fits or work > cheapest or count > MOST_STEPS:
                    break
                count = max(count + 1, math.ceil(GROWTH * count))
            cheapest = min(cheapest, work) if fits else cheapest
            dt = self.control_dt / count
            rung = Rung(
                description=f"{name}, dt {dt:.4g} s",
                error=error,
                integration=self._between(self.episodes.played(core), self._trace(fidelity)),
                operations=operations,
                cost=work if fits else None,
            )
            yield Step(fidelity, name, dt, rung)

    def _trace(self, fidelity: Fidelity) -> Trace:
        if fidelity not in self._traces:
            self._traces[fidelity] = self._played(fidelity, METHOD, self._fine)
        return self._traces[fidelity]

    def _played(self, fidelity: Fidelity, integrator: str, substeps: int) -> Trace:
        core = self._core(fidelity, integrator, substeps, len(self.episodes.kinds))
        self.progress.motion()
        return self.episodes.played(core)

    def _between(self, a: Trace, b: Trace) -> float:
        return Distances.between(a, b, self.episodes.kinds).worst_share

    def _core(self, fidelity: Fidelity, integrator: str, substeps: int, count: int) -> Core:
        limit = DEFLECTION_LIMIT * (1.0 if fidelity == self._reference else WIDER)
        return environment(self.arm, count, {
            "control_dt": self.control_dt, "integrator": integrator, "substeps": substeps,
            "fidelity": fidelity, "deflection_limit": limit,
        })  # fmt: skip
