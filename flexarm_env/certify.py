"""Certify the registered environments: `python -m flexarm_env.certify [ARM ...]`.

Each arm's step is chosen first: of every method in METHODS the fewest substeps that keep the tip
within TIP_ERROR of the reach through episodes of random torques; then the method that takes the
least time, where a tenth of the error is worth a tenth more of it. That model and step are then
certified on motions of their kind: all joints bang-bang at full torque for one period of the first
joint-free mode, then coasting, and random torques held for a control step each. Leave the machine
alone while it runs.
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

ACCURACY, LONG_ACCURACY = 1e-4, 1e-3  # of the reach; for more than two links, to end in minutes
METHODS = ("rk4", "numerov", "exponential", "midpoint")
TIP_ERROR = 1e-3  # of the reach, at any time of an episode, by the step alone
EPISODES = 32
FINER = 4  # times the Runge-Kutta steps of an arm: the truth for steps
MOST_STEPS = 16  # per control step; more than that is never the cheapest
BATCH = 1024  # environments that are timed together
TIMED = 500  # rounds, a second of each: what is chosen should not hang on the machine's mood
WORTH = 0.1  # of the time more, for a tenth of the error

Step = dict[str, Any]  # integrator, substeps, error in parts of the reach, seconds


def strayed(arm: str, control_dt: float, length: int, integrator: str, substeps: int) -> float:
    """Largest tip error in parts of the reach, over EPISODES of random torques of `length` steps.

    Infinite where an environment diverges that does not in finer steps.
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
    """The fewest substeps of a method that are stable and accurate; None up to MOST_STEPS."""
    limit = SAFE * INTEGRATORS[integrator].limit
    first = int(control_dt * scales(load_arm(arm)).fastest / limit) + 1
    for substeps in range(first, MOST_STEPS + 1):
        error = strayed(arm, control_dt, length, integrator, substeps)
        if error < TIP_ERROR:
            return {"integrator": integrator, "substeps": substeps, "error": error}
    return None


def timed(arm: str, control_dt: float, steps: list[Step]) -> list[Step]:
    """The steps with `seconds`: CPU time of one environment in a batch."""
    calls = {}
    for k, step in enumerate(steps):
        core = Core(task="Reach", arm=arm, control_dt=control_dt, n_env=BATCH,
                    integrator=step["integrator"], substeps=step["substeps"])  # fmt: skip
        core.reset(np.arange(BATCH))
        calls[k] = partial(core.step, np.zeros((BATCH, core.arm.n_joint), np.float32))
    seconds = cpu_seconds(calls, TIMED)
    return [{**step, "seconds": seconds[k] / BATCH} for k, step in enumerate(steps)]


def best_first(steps: list[Step]) -> list[Step]:
    """Those that take the least time first, with more time for more accuracy: see WORTH."""
    return sorted(steps, key=lambda k: math.log(k["seconds"]) + WORTH * math.log10(k["error"]))


def measure(name: str, control_dt: float, integrator: str, substeps: int) -> Certificate:
    """The certificate of a preset at its environments' step."""
    arm = load_arm(name)
    accuracy = (ACCURACY if arm.n_joint <= 2 else LONG_ACCURACY) * arm.reach
    return certify(arm, scene(arm, control_dt), integrator, control_dt / substeps, accuracy)


def main() -> None:
    """Measure the default arms, or those named, and keep what was found."""
    known = {arm: (control_dt, length) for arm, control_dt, length in SCENES.values()}
    parser = argparse.ArgumentParser(description="Certify the environments' arms.")
    parser.add_argument("arms", nargs="*", metavar="ARM", help=f"of {sorted(known)}; all")
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
