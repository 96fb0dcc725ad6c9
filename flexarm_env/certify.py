"""Certify the registered environments: `python -m flexarm_env.certify [ARM ...]`.

Each arm's step is chosen first. For every method in METHODS this finds the fewest substeps that
keep the tip within TIP_ERROR of the reach through episodes of random torques. Of these it takes the
method with the least CPU time, allowing a tenth more time for a tenth of the error. Model and step
are then certified on two motions: all joints bang-bang at full torque for one period of the first
joint-free mode, then coasting; and random torques, constant over each control step. Run nothing
else on the machine meanwhile.
"""

import argparse
import json
import math
from functools import partial
from typing import Any

import numpy as np

from dynamics.accuracy.certificate import Certificate, certify
from dynamics.integrators.table import INTEGRATORS
from dynamics.load import load_arm
from flexarm_env.accuracy.certificates import RANDOM_SHARE, STORE, scene, stored
from flexarm_env.accuracy.timing import cpu_seconds
from flexarm_env.core import Core
from flexarm_env.registration import SCENES
from flexarm_env.scales import SAFE, integration, scales

ACCURACY, LONG_ACCURACY = 1e-4, 1e-3  # [of the reach] second: above two links, to end in minutes
METHODS = ("rk4", "numerov", "exponential", "midpoint")
TIP_ERROR = 1e-3  # of the reach, at any time of an episode, due to the step alone
EPISODES = 32
FINER = 4  # times the Runge-Kutta steps of an arm: the reference for steps
MOST_STEPS = 16  # per control step; more than that is never the cheapest
BATCH = 1024  # environments that are timed together
TIMED = 500  # timing rounds, a second of each method: the choice must not depend on disturbances
TIME_PER_DECADE = 0.1  # relative increase of CPU time that is accepted for a tenth of the error

Step = dict[str, Any]  # integrator, substeps, error [of the reach], seconds


def largest_error(
    arm: str, control_dt: float, length: int, integrator: str, substeps: int
) -> float:
    """Largest tip error [of the reach] over EPISODES of random torques, `length` steps each.

    Infinite if at any step more episodes end than with finer steps.
    """
    setting: dict[str, Any] = {"task": "Reach", "arm": arm, "control_dt": control_dt}
    count = FINER * integration(load_arm(arm), control_dt, "rk4")[1]
    coarse = Core(**setting, n_env=EPISODES, integrator=integrator, substeps=substeps)
    fine = Core(**setting, n_env=EPISODES, integrator="rk4", substeps=count)
    for core in (coarse, fine):
        for row in range(EPISODES):
            core.seed(row, np.random.default_rng(row))
        core.reset(np.arange(EPISODES))
    rng, worst = np.random.default_rng(0), 0.0
    for _ in range(length):
        torque = rng.uniform(-RANDOM_SHARE, RANDOM_SHARE, (EPISODES, coarse.arm.n_joint))
        ended = [core.step(torque.astype(np.float32))[-1] for core in (coarse, fine)]
        if ended[0] > ended[1]:
            return float("inf")
        tips = [np.array([core.model.tip(q) for q in core.q]) for core in (coarse, fine)]
        worst = max(worst, float(np.linalg.norm(tips[0] - tips[1], axis=1).max()))
    return worst / coarse.arm.reach


def fewest_steps(arm: str, control_dt: float, length: int, integrator: str) -> Step | None:
    """Step with the fewest stable and accurate substeps of a method; None above MOST_STEPS."""
    limit = SAFE * INTEGRATORS[integrator].limit
    first = int(control_dt * scales(load_arm(arm)).fastest / limit) + 1
    for substeps in range(first, MOST_STEPS + 1):
        error = largest_error(arm, control_dt, length, integrator, substeps)
        if error < TIP_ERROR:
            return {"integrator": integrator, "substeps": substeps, "error": error}
    return None


def timed(arm: str, control_dt: float, steps: list[Step]) -> list[Step]:
    """The steps with `seconds` added: CPU time per control step of one environment in a batch."""
    calls = {}
    for k, step in enumerate(steps):
        core = Core(task="Reach", arm=arm, control_dt=control_dt, n_env=BATCH,
                    integrator=step["integrator"], substeps=step["substeps"])  # fmt: skip
        core.reset(np.arange(BATCH))
        calls[k] = partial(core.step, np.zeros((BATCH, core.arm.n_joint), np.float32))
    seconds = cpu_seconds(calls, TIMED)
    return [{**step, "seconds": seconds[k] / BATCH} for k, step in enumerate(steps)]


def best_first(steps: list[Step]) -> list[Step]:
    """Sort by CPU time, corrected for the error by TIME_PER_DECADE."""

    def cost(step: Step) -> float:
        return math.log(step["seconds"]) + TIME_PER_DECADE * math.log10(step["error"])

    return sorted(steps, key=cost)


def measure(name: str, control_dt: float, integrator: str, substeps: int) -> Certificate:
    """Certificate of a preset arm with this step."""
    arm = load_arm(name)
    accuracy = (ACCURACY if arm.n_joint <= 2 else LONG_ACCURACY) * arm.reach
    return certify(arm, scene(arm, control_dt), integrator, control_dt / substeps, accuracy)


def main() -> None:
    """Measure all registered arms, or those named, and write certificates.json."""
    known = {arm: (control_dt, length) for arm, control_dt, length in SCENES.values()}
    parser = argparse.ArgumentParser(description="Certify the environments' arms.")
    parser.add_argument("arms", nargs="*", metavar="ARM", help=f"of {sorted(known)}; default: all")
    names = parser.parse_args().arms or list(known)
    unknown = sorted(set(names) - set(known))
    if unknown:
        parser.error(f"unknown arms {unknown}; known: {sorted(known)}")
    entries = dict(stored())
    for name in names:
        control_dt, length = known[name]
        found = [fewest_steps(name, control_dt, length, method) for method in METHODS]
        steps = best_first(timed(name, control_dt, [step for step in found if step]))
        best = steps[0]
        certificate = measure(name, control_dt, best["integrator"], best["substeps"]).to_dict()
        entries[name] = {"control_dt": control_dt, "steps": steps, "certificate": certificate}
        print(f"{name}: {json.dumps(entries[name], indent=2)}")
        STORE.write_text(json.dumps(entries, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
