"""Errors of an arm's model and step: `python -m flexarm_env.certify [ARM ...] [--control-dt S]`.

ARM is a preset or an arm file; certificates.json stores the registered environments' arms only. The
tables are those of an environment's page. Errors are measured on two motions: all joints bang-bang
at full torque for one period of the first joint-free mode, then coasting; and random torques,
constant over each control step. For every method in METHODS this finds the fewest substeps that
keep the error of model and step together within TIP_ERROR of the reach, or within SLACK times the
model's own error where that is larger. A method that errs by more than EPISODE_ERROR in an episode
of Reach or Damp, by the step alone, is left out, and on a floating base one that loses more than
MOMENTUM_ERROR of its momentum. Of the others it takes that with the least CPU
time, allowing a tenth more time for a tenth of the error. Run nothing else on the machine
meanwhile.
"""

import argparse
import json
import math
import sys
from functools import partial
from typing import Any

import numpy as np

from dynamics.accuracy.certificate import Certifier
from dynamics.accuracy.progress import Progress
from dynamics.description.arm import Arm
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import ArmSource, load_arm
from flexarm_env import arguments
from flexarm_env.accuracy.certificates import STORE, Fitted, fit, scene
from flexarm_env.accuracy.episodes import (
    EPISODE_ERROR,
    MOMENTUM_ERROR,
    episode_error,
    momentum_error,
)
from flexarm_env.accuracy.table import accuracy
from flexarm_env.accuracy.timing import cpu_seconds
from flexarm_env.core import Core
from flexarm_env.registration import SCENES
from flexarm_env.scales import SAFE, scales

ACCURACY = 1e-4  # [of the reach] of the reference
METHODS = ("rk4", "numerov", "exponential", "midpoint", "relaxed-midpoint")
TIP_ERROR = 1e-3  # [of the reach] of model and step together
SLACK = 1.1  # [-] error with a step over that of a model that errs by more than TIP_ERROR itself
MOST_STEPS = 24  # per control step; more than that is never the cheapest
BATCH = 1024  # environments that are timed together
TIMED = 500  # timing rounds, a second of each method: the choice must not depend on disturbances
TIME_PER_DECADE = 0.1  # relative increase of CPU time that is accepted for a tenth of the error
PERIOD_SHARE = 0.15  # [-] control step over the first joint-free period of such an arm
ROUND = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)  # [s] its control step

Entry = dict[str, Any]  # control_dt, steps, certificate
Step = dict[str, Any]  # integrator, substeps, error and episode_error [of the reach], seconds


def fewest_steps(certifier: Certifier, control_dt: float, integrator: str) -> Step | None:
    """Step with the fewest stable and accurate substeps of a method; None above MOST_STEPS.

    One substep more has to confirm it.
    """
    arm, reach = certifier.arm, certifier.arm.reach
    allowed = max(TIP_ERROR * reach, SLACK * certifier.model_error)
    limit = SAFE * INTEGRATORS[integrator].limit
    first, errors = int(control_dt * scales(arm).fastest / limit) + 1, [math.inf]
    for substeps in range(first, MOST_STEPS + 2):
        errors.append(certifier.error(integrator, control_dt / substeps))
        if max(errors[-2:]) <= allowed:
            return {"integrator": integrator, "substeps": substeps - 1, "error": errors[-2] / reach}
    return None


def timed(arm: ArmSource, control_dt: float, steps: list[Step]) -> list[Step]:
    """The steps with `seconds` added: CPU time per control step of one environment in a batch."""
    calls = {}
    for k, step in enumerate(steps):
        core = Core(task="Reach", arm=arm, control_dt=control_dt, n_env=BATCH,
                    integrator=step["integrator"], substeps=step["substeps"])  # fmt: skip
        core.reset(np.arange(BATCH))
        calls[k] = partial(core.step, np.zeros((BATCH, core.arm.n_torque), np.float32))
    seconds = cpu_seconds(calls, TIMED)
    return [{**step, "seconds": seconds[k] / BATCH} for k, step in enumerate(steps)]


def best_first(steps: list[Step]) -> list[Step]:
    """Sort by CPU time, corrected for the error by TIME_PER_DECADE."""

    def cost(step: Step) -> float:
        return math.log(step["seconds"]) + TIME_PER_DECADE * math.log10(step["error"])

    return sorted(steps, key=cost)


def certifier_of(source: ArmSource, control_dt: float) -> Certifier:
    """Errors of an arm on the motions of its `scene`."""
    arm = load_arm(source)
    with Progress(None) as line:
        return Certifier(arm, scene(arm, control_dt), ACCURACY * arm.reach, line)


def default_control_dt(arm: Arm) -> float:
    """Control step [s] of an arm that is not registered.

    It is PERIOD_SHARE of the first joint-free period, or ROUND[-1] for rigid links, rounded down
    to one of ROUND.
    """
    free = scales(arm).free
    wanted = PERIOD_SHARE * 2.0 * math.pi / free[0] if free else ROUND[-1]
    return max((dt for dt in ROUND if dt <= wanted), default=ROUND[0])


def described(source: str, control_dt: float | None) -> tuple[Fitted, float]:
    """Model that an environment steps for an arm, its and its control step [s]."""
    known = {arm: dt for arm, dt, _ in SCENES.values()}
    arm = load_arm(source)
    if control_dt is None:
        control_dt = known[source] if source in known else default_control_dt(arm)
    dt = arguments.within("--control-dt", control_dt, *arguments.CONTROL_DT, "s")
    return fit(arm, dt, "auto", None), dt


def entry(source: str, control_dt: float | None) -> Entry:
    """Measured steps and certificate of a preset or an arm file, as certificates.json stores them.

    Raises
    ------
    ValueError : for an arm that no environment takes, or without a step of sufficient accuracy.
    RuntimeError : if the reference does not converge.
    """
    fitted, dt = described(source, control_dt)
    arm = fitted.arm
    _report(f"{source}: reference")
    certifier, found = certifier_of(arm, dt), []
    for method in METHODS:
        _report(f"{source}: fewest steps of {method}")
        found.append(fewest_steps(certifier, dt, method))
    enough = []
    for step in filter(None, found):
        of = arm, dt, step["integrator"], step["substeps"]
        error = episode_error(*of)
        if error <= EPISODE_ERROR and momentum_error(*of) <= MOMENTUM_ERROR:
            enough.append(step | {"episode_error": error})
    if not enough:
        raise ValueError(
            f"No method keeps the tip within {TIP_ERROR:g} of the reach with at most {MOST_STEPS} "
            f"steps per control step of {dt:g} s; give a smaller --control-dt."
        )
    _report(f"{source}: CPU time of {len(enough)} methods")
    steps = best_first(timed(arm, dt, enough))
    best = steps[0]
    _report(f"{source}: certificate of {best['integrator']}, {best['substeps']} steps")
    certificate = certifier.certificate(best["integrator"], dt / best["substeps"]).to_dict()
    if fitted.reason:
        certificate["reason"] = fitted.reason
    return {"control_dt": dt, "steps": steps, "certificate": certificate}


def is_registered(source: str, control_dt: float) -> bool:
    """True for the preset and control step of a registered environment."""
    return (source, control_dt) in {(arm, dt) for arm, dt, _ in SCENES.values()}


def _report(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def main(given: list[str] | None = None, prog: str = "python -m flexarm_env.certify") -> int:
    """Print the tables of the named arms, store those of registered ones; the exit status."""
    known = [arm for arm, _, _ in SCENES.values()]
    parser = argparse.ArgumentParser(prog=prog, description="Measure the errors of arms.")
    parser.add_argument(
        "arms", nargs="*", metavar="ARM", default=known,
        help="preset or arm file (.json, .yaml); default: the registered arms, " + ", ".join(known),
    )  # fmt: skip
    parser.add_argument(
        "--control-dt", type=float, metavar="S",
        help="time between actions [s]; default: that of the registered environment, else "
        f"{PERIOD_SHARE:g} of the first joint-free period, rounded down to one of {ROUND}",
    )  # fmt: skip
    options = parser.parse_args(given)
    for source in options.arms:
        try:
            measured = entry(source, options.control_dt)
        except (ValueError, RuntimeError) as error:
            _report(f"{prog.removeprefix('python -m ')}: {' '.join(str(error).split())}")
            return 2
        dt = measured["control_dt"]
        command = f"python -m flexarm_env.certify {source}"
        if is_registered(source, dt):
            entries = {**json.loads(STORE.read_text(encoding="utf-8")), source: measured}
            STORE.write_text(json.dumps(entries, indent=2) + "\n", encoding="utf-8")
        else:
            command += f" --control-dt {dt:g}"
        print(f"# {source}, control step {dt:g} s\n")
        print(accuracy(measured["certificate"] | {"reproduce": command}, measured["steps"]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
