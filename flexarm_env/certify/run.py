"""Errors of an arm's model and step over whole episodes: `flexarm certify ARM [--set KEY=VALUE]`.

ARM is a preset, an arm file or the id of an environment. The tables are those of an environment's
page. For every method in `search.METHODS` this finds the fewest substeps that keep the tip within
TIP_ERROR of the reach in 95 of 100 episodes of each kind in `motions.KINDS`, or within SLACK times
the model's own error where that is larger, and on a floating base the momentum within
MOMENTUM_ERROR. Of these it takes the method with the least CPU time, allowing a tenth more time for
a tenth of the error. `gym.make` of the same arm and keywords finds what this measured. `--store`
measures registered environments under all conditions in `conditions`, and writes
certificates.json, from which ids take their steps. Run nothing else on the machine meanwhile.
"""

import argparse
import json
import math
import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import yaml

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.load import load_arm
from dynamics.progress import Progress
from flexarm_env import arguments
from flexarm_env.accuracy.certificates import STORE, Entry, Fitted, fit, keep
from flexarm_env.accuracy.table import accuracy
from flexarm_env.certify.certificate import EPISODES, Certifier
from flexarm_env.certify.choice import LENGTH
from flexarm_env.certify.search import (
    MOST_STEPS,
    TIP_ERROR,
    best_first,
    given_step,
    sufficient_steps,
    timed,
)
from flexarm_env.hardware.actuators import load_actuators, mounted
from flexarm_env.registration import AGILE, HARDER, IDS, SCENES, registered
from flexarm_env.task.scales import scales

PERIOD_SHARE = 0.15  # [-] control step over the first joint-free period of an own arm
ROUND = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)  # [s] its control step
STEP = ("integrator", "substeps")
# steps of ids with an event, which are older than the measurement of its errors
FROZEN: dict[str, dict[str, Any]] = {"drop": {"integrator": "exponential-4", "substeps": 2}}
ALL = "all"  # registered scenes, for --store
KEYWORDS = (
    "torque_limit", "base_torque", "actuator", "hardware", "randomize", "deflection_limit", "event",
    *STEP,
)  # fmt: skip


def default_control_dt(arm: Arm) -> float:
    """Control step [s] of an arm that is not registered.

    It is PERIOD_SHARE of the first joint-free period, or ROUND[-1] for rigid links, rounded down
    to one of ROUND.
    """
    free = scales(arm).free
    wanted = PERIOD_SHARE * 2.0 * math.pi / free[0] if free else ROUND[-1]
    return max((dt for dt in ROUND if dt <= wanted), default=ROUND[0])


def conditions(scene: str) -> list[dict[str, Any]]:
    """Keywords under which a registered scene is measured."""
    agile = [{"torque_limit": list(AGILE[scene])}] if scene in AGILE else []
    events = [HARDER[x].get("event") for x in HARDER if x[0] == scene]
    met = [{"event": x, **FROZEN.get(x, {})} for x in ("push", "drop") if x in events]
    return [{}, *agile, {"hardware": "laboratory"}, *met]


def entry(
    fitted: Fitted, control_dt: float, steps: int, keywords: Mapping[str, Any], line: Progress
) -> Entry:
    """Measured steps and certificate of a model in episodes of a number of control steps.

    Raises
    ------
    ValueError : for keywords that no environment takes, or without a step of sufficient accuracy.
    """
    others = {key: value for key, value in keywords.items() if key not in STEP}
    known = {"control_dt": control_dt} | others
    certifier = Certifier(fitted.arm, known, steps, line, count=EPISODES)
    line.stage("steps")
    if all(key in keywords for key in STEP):
        enough = [given_step(certifier, *(keywords[key] for key in STEP))]
    else:
        enough = sufficient_steps(certifier)
    if not enough:
        raise ValueError(
            f"No method keeps the tip within {TIP_ERROR:g} of the reach with at most {MOST_STEPS} "
            f"steps per control step of {control_dt:g} s; give a smaller --control-dt."
        )
    line.stage("times")
    best = best_first(timed(certifier, enough))
    certificate = certifier.certificate(best[0]["integrator"], best[0]["substeps"])
    if fitted.reason:
        certificate["reason"] = fitted.reason
    return {"steps": best, "certificate": certificate}


def described(
    source: str, control_dt: float | None, given: Mapping[str, Any]
) -> tuple[Fitted, float, int, dict[str, Any]]:
    """Model, control step [s], steps per episode and keywords of an id, a preset or an arm file.

    The model is that of the arm with its motors, which are left to the keywords.
    """
    keywords: dict[str, Any] = {}
    known = {arm: (dt, steps) for arm, dt, steps in SCENES.values()}
    if source.removeprefix("flexarm_env:").startswith("FlexArm/"):
        spec = IDS[registered(source)]["kwargs"]
        keywords = {key: spec[key] for key in KEYWORDS if key in spec}
        source = spec["arm"]
    arm = load_arm(source)
    dt, steps = known.get(source, (None, LENGTH))
    if control_dt is not None or dt is None:
        dt = default_control_dt(arm) if control_dt is None else control_dt
    dt = arguments.within("--control-dt", dt, *arguments.CONTROL_DT, "s")
    keywords |= given
    fitted = fit(_with_motors(arm, keywords), dt, "auto", None)
    pairs = zip(fitted.arm.links, arm.links, strict=True)
    links = tuple(replace(link, joint=own.joint) for link, own in pairs)
    return replace(fitted, arm=replace(fitted.arm, links=links)), dt, steps, keywords


def _with_motors(arm: Arm, keywords: Mapping[str, Any]) -> Arm:
    return mounted(arm, load_actuators(keywords.get("actuator"), arm.n_joint))


def measure_all(line: Progress, only: str) -> None:
    """Measure the registered scenes under all their conditions, and write certificates.json."""
    for scene, (arm, dt, steps) in SCENES.items():
        if only not in (ALL, arm):
            continue
        measured = []
        for keywords in conditions(scene):
            _report(f"{arm}, {keywords or 'as it is'}")
            found = entry(Fitted(load_arm(arm)), dt, steps, keywords, line)
            print(accuracy(found, command(arm, keywords)) + "\n", flush=True)
            measured.append(found)
        stored = json.loads(STORE.read_text(encoding="utf-8")) if STORE.exists() else {}
        stored[arm] = {"control_dt": dt, "measured": measured}
        STORE.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


def command(source: str, keywords: Mapping[str, Any], control_dt: float | None = None) -> str:
    """The command that measures an entry again, as a shell takes it."""
    texts = {key: x if isinstance(x, str) else json.dumps(x) for key, x in keywords.items()}
    given = "".join(f" --set {shlex.quote(f'{key}={text}')}" for key, text in texts.items())
    dt = "" if control_dt is None else f" --control-dt {control_dt:g}"
    return f"flexarm certify {shlex.quote(source)}{dt}{given}"


def setting(text: str) -> tuple[str, Any]:
    """KEY=VALUE of the command line, the value in YAML."""
    key, equals, value = text.partition("=")
    if not equals or key not in KEYWORDS:
        raise argparse.ArgumentTypeError(f"must be KEY=VALUE, KEY one of {', '.join(KEYWORDS)}")
    try:
        return key, yaml.safe_load(value)
    except yaml.YAMLError as error:
        raise argparse.ArgumentTypeError(f"{key} is no YAML: {error}") from None


def _report(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def main(given: list[str] | None = None, prog: str = "python -m flexarm_env.certify") -> int:
    """Measure the named arms and print their tables; the exit status."""
    parser = argparse.ArgumentParser(prog=prog, description="Measure the errors of arms.")
    parser.add_argument(
        "arms", nargs="*", metavar="ARM", help="preset, arm file (.json, .yaml) or id"
    )
    parser.add_argument(
        "--control-dt", type=float, metavar="S",
        help="time between actions [s]; default: that of the registered environment, else "
        f"{PERIOD_SHARE:g} of the first joint-free period, rounded down to one of {ROUND}",
    )  # fmt: skip
    parser.add_argument(
        "--set", type=setting, action="append", default=[], metavar="KEY=VALUE",
        help=f"keyword of the environment, the value in YAML: {', '.join(KEYWORDS)}",
    )  # fmt: skip
    parser.add_argument(
        "--store", metavar="PRESET",
        help=f"for developers: measure one registered scene, or {ALL}, and replace its steps",
    )  # fmt: skip
    options = parser.parse_args(given)
    if not options.arms and options.store is None:
        parser.error("an ARM is missing, such as slim, my_arm.yaml or FlexArm/OneLink-Reach-v0")
    try:
        if options.store is not None:
            validate.choice(options.store, "--store", [ALL, *(x[0] for x in SCENES.values())])
        with Progress(None) as line:
            if options.store:
                measure_all(line, options.store)
            for source in options.arms:
                changes = validate.unique(options.set, "--set")
                fitted, dt, steps, keywords = described(source, options.control_dt, changes)
                _report(f"{source}: {EPISODES} episodes of each kind, control step {dt:g} s")
                found = entry(fitted, dt, steps, keywords, line)
                keep(_with_motors(fitted.arm, keywords), dt, found)
                print(f"# {source}, {steps} control steps of {dt:g} s\n")
                print(accuracy(found, command(source, changes, options.control_dt)))
    except (ValueError, TypeError, RuntimeError) as error:
        _report(f"{prog.removeprefix('python -m ')}: {' '.join(str(error).split())}")
        return 2
    return 0
