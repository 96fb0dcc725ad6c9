"""Policies distilled from classical controllers, beside their experts in the same episodes.

    python -m benchmarks.training.distilled [--only NAME ...]

Takes the shipped policies of every experiment with `learned: distilled` and of every one with a
warm start from such an experiment, or those that are named; the others stay as they are stored.
Writes docs/results/distilled.json and distilled.md.
"""

import json
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from agents.comparison import titled
from agents.config import BaseConfig, Config, load_config
from agents.experiments import shipped_experiments
from agents.export.c_header import header
from agents.export.signals import signals_of
from agents.hybrid.informed import expert, is_told
from agents.leaderboard.decisions import decision_times
from agents.leaderboard.shipped import named_policy, shipped_policies
from agents.learners.algorithms import DISTILLED
from agents.metrics import episode_metrics, make_batch, record
from agents.policy import Controller, Policy
from agents.sentences import one_line
from agents.training import base_description
from benchmarks.output import argument_parser, provenance, save_results, table
from benchmarks.training.experiments import stored_seconds
from dynamics.description import validate
from dynamics.types import AnyArray

FIRST, EPISODES = 20_000, 200  # test episodes, other than those of the training and of tuning
RESAMPLES = 2_000
CALLS = 100_000  # timed calls in C
HEADER = (
    "experiment", "expert", "policy", "gain on the expert [95 %]", "gain on the warm start [95 %]",
    "training [s]", "expert [us]", "policy [us]", "in C [us]",
)  # fmt: skip
MAIN = """
#include <stdio.h>
#include <time.h>
#include "policy.h"

int main(void)
{
    policy_memory memory;
    double input[POLICY_INPUTS] = {0.0}, torque[POLICY_OUTPUTS], sum = 0.0;
    policy_start(&memory);
    const clock_t begin = clock();
    for (int k = 0; k < CALLS; k++) {
        input[0] = 1e-5 * (k % 1000);
        policy_act(&memory, input, torque);
        sum += torque[0];
    }
    printf("%.9g %g", 1e6 * (clock() - begin) / CLOCKS_PER_SEC / CALLS, sum);
    return 0;
}
"""


def distilled() -> list[tuple[Config, BaseConfig]]:
    """Shipped experiments whose policy imitates a controller, or begins with one that does.

    Each with the expert, and a warm start after the experiment that it begins with.
    """
    configs = {name: load_config(path) for name, path in shipped_experiments().items()}
    first = {name: c.base for name, c in configs.items() if c.base and c.base.learned == DISTILLED}
    found = [(configs[name], base) for name, base in first.items()]
    for config in configs.values():
        if config.agent.warm_start in first:
            found.append((config, first[config.agent.warm_start]))
    return sorted(found, key=lambda pair: pair[0].agent.warm_start or pair[0].name)


def gain(policy: AnyArray, other: AnyArray) -> tuple[float, float, float]:
    """Mean gain of scores (seeds, episodes) on others (episodes,) or (seeds, episodes), with 95 %.

    Training seeds and episodes are resampled, both in pairs with the others'.
    """
    rng, gains = np.random.default_rng(0), policy - other
    seeds, episodes = gains.shape
    means = [
        gains[rng.integers(seeds, size=seeds)][:, rng.integers(episodes, size=episodes)].mean()
        for _ in range(RESAMPLES)
    ]
    low, high = np.percentile(means, (2.5, 97.5))
    return float(gains.mean()), float(low), float(high)


def stored_rows(path: Path, only: Sequence[str] | None) -> dict[str, dict[str, Any]]:
    """Rows of a file by experiment, without those to measure; a ValueError if one is missing."""
    if only is None:
        return {}
    names = [config.name for config, _ in distilled()]
    for name in only:
        validate.known(name, "experiment of --only", names)
    rows = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.exists() else []
    kept = {row["name"]: row for row in rows if row["name"] not in only}
    if missing := sorted(set(names) - set(only) - set(kept)):
        raise ValueError(f"--only: {path} has no row of {missing}; name them too.")
    return kept


def row(config: Config, base: BaseConfig) -> dict[str, Any]:
    """Scores, training times and times of decisions of an experiment beside its expert."""
    policies, seconds = shipped_policies(config), stored_seconds(config.name)
    seeds = [policy.about["seed"] for policy in policies]
    begun = config.agent.warm_start
    warm = [named_policy(begun, seed) for seed in seeds] if begun else []
    env_id, kwargs = config.env.id, config.env.kwargs
    parameters = base_description(base, config.env)["parameters"]
    envs, single = (make_batch(env_id, n, kwargs) for n in (EPISODES, 1))
    with closing(envs), closing(single):
        taught, alone = (expert(base.controller, x, parameters) for x in (envs, single))
        theirs, *rest = (score(x, envs) for x in (taught, *policies, *warm))
        ours, starts = np.array(rest[: len(seeds)]), np.array(rest[len(seeds) :])
        return {
            "name": config.name,
            "env": titled(env_id, kwargs),
            "expert": base.controller + ", told" * is_told(base.controller, envs),
            "seeds": seeds,
            "expert_score": float(theirs.mean()),
            "scores": ours.mean(axis=1).tolist(),
            "gain": gain(ours, theirs),
            "gain_on_start": gain(ours, starts) if warm else None,
            "seconds": [seconds[seed] for seed in seeds],
            "expert_us": 1e3 * float(np.median(decision_times(alone, single, FIRST))),
            "policy_us": 1e3 * float(np.median(decision_times(policies[0], single, FIRST))),
            "c_us": in_c(policies[0], env_id, single.unwrapped.core),
        }


def score(subject: Controller, envs: Any) -> AnyArray:
    """(EPISODES,) scores of the test episodes."""
    episodes = range(FIRST, FIRST + EPISODES)
    found: AnyArray = episode_metrics(record(subject, envs, episodes))["score"]
    return found


def in_c(policy: Policy, env_id: str, core: Any) -> float | None:
    """[us] CPU time of a decision of the exported header; None without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        text = header(policy, signals_of(policy, env_id, core), "policy")
        (folder / "policy.h").write_text(text, encoding="ascii")
        (folder / "main.c").write_text(MAIN, encoding="ascii")
        build = [compiler, "-std=c99", "-O2", f"-DCALLS={CALLS}", "main.c", "-o", "main", "-lm"]
        subprocess.run(build, cwd=folder, check=True)
        done = subprocess.run(["./main"], cwd=folder, check=True, capture_output=True, text=True)
    return float(done.stdout.split()[0])


def interval(found: Sequence[float] | None) -> str:
    """Text of a gain."""
    return "-" if found is None else "{:+.4f} [{:+.4f}, {:+.4f}]".format(*found)


def cells(found: dict[str, Any]) -> list[str]:
    """Texts of a row, in the order of HEADER."""
    least, most, count = min(found["seconds"]), max(found["seconds"]), len(found["seeds"])
    times = (found[key] for key in ("expert_us", "policy_us", "c_us"))
    training = (
        f"{least:.0f} to {most:.0f}, {count} seeds" if count > 1 else f"{least:.0f}, one seed"
    )
    return [
        f"[{found['name']}]({found['name']}.md): {found['env']}",
        f"{found['expert']} {found['expert_score']:.3f}",
        f"{np.mean(found['scores']):.3f}",
        *(interval(found[key]) for key in ("gain", "gain_on_start")),
        training,
        *("" if x is None else f"{x:.3g}" for x in times),
    ]


def page(results: dict[str, Any]) -> str:
    """Markdown page of the results."""
    rows = results["rows"]
    machine = results["provenance"]["machine"]
    return f"""# Distilled policies

Made by `python -m benchmarks.training.distilled` on {machine["processor"]}, the latest rows by
`{results["provenance"]["command"]}`.

A policy without a model learns from a classical controller, its expert, by DAgger
([training](../training.md#distilled-policies)); PPO may begin with its weights
([warm starts](../training.md#warm-starts)). Scores are means over {EPISODES} episodes from seed
{FIRST} on, which neither training nor tuning uses, and over the training seeds. Gains: the policy's
score less that of the expert, or of the policy with which it began, in the same episodes, with a
bootstrap over seeds and episodes. "Told": the expert knows the exact state and the plant, and the
policy sees the sensors alone; the [ranking](leaderboard.md#kinds) has controllers that see no more.
Times are of one decision: medians of the controllers in Python, and the mean of the
[exported C header](../export.md) with `cc -O2`. Training: wall-clock time of one process, longer
where other work kept the machine busy.

{table(HEADER, map(cells, rows), "lrr")}
"""


def main() -> None:
    """Command line."""
    parser = argument_parser("training.distilled", __doc__, "distilled.json")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="experiments to measure")
    a = parser.parse_args()
    try:
        kept = stored_rows(a.out, a.only)
    except ValueError as error:
        parser.error(one_line(error))
    rows = [kept.get(config.name) or row(config, base) for config, base in distilled()]
    results = {"rows": rows, "provenance": provenance("flexarm", "torch", "stable_baselines3")}
    save_results(results, page, a.out)


if __name__ == "__main__":
    main()
