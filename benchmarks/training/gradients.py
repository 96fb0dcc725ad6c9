"""Cost of gradients through the control step, and what a learner gains from them.

    python -m benchmarks.training.gradients [--keep FOLDER]

Times the step of batches of one, two and six links, its recording and its derivatives, then trains
every shipped experiment with `shac` and the one with `ppo` for the same environment. Writes
docs/results/gradients.json and gradients.md. Run nothing else on the machine meanwhile.
"""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.comparison import titled
from agents.config import Config, load_config
from agents.experiments import shipped_experiments
from agents.learners.algorithms import DIFFERENTIATED
from agents.metrics import episode_metrics
from benchmarks.output import argument_parser, provenance, save_results, table
from benchmarks.speed.timing import timed_in_turn
from benchmarks.training.runs import recorded, run_seed
from flexarm_env import FlexArmVectorEnv
from flexarm_env.derivatives import Derivatives

SCENES = ("OneLink", "TwoLink", "SixLink")
ENVIRONMENTS = 1024
FIRST, EPISODES = 20_000, 200  # test episodes, other than those of the training and of tuning
COSTS = (
    "batch", "step [us]", "recorded", "pulled back", "pushed forward", "stack [kB]", "state [kB]",
)  # fmt: skip
LEARNERS = ("environment", "learner", "steps", "seconds", "score", "settling [s]", "success [%]")


def cost(scene: str) -> dict[str, Any]:
    """Times [s] of a step of a batch and of its derivatives, and memory of a step [B]."""
    envs = gym.make_vec(f"FlexArm/{scene}-Reach-v0", ENVIRONMENTS)
    assert isinstance(envs, FlexArmVectorEnv)
    envs.reset(seed=0)
    core, derivatives = envs.core, Derivatives(envs.core)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.5, 0.5, envs.action_space.shape).astype(np.float32)
    core.step(actions)
    state = core.state.copy()
    step = derivatives.record(state, actions)
    bars = [rng.normal(size=x.shape).astype(x.dtype) for x in (step.after, step.obs, step.info)]
    calls: dict[str, Callable[[], Any]] = {
        "step": partial(core.step, actions),
        "record": partial(derivatives.record, state, actions),
        "pull_back": partial(derivatives.pull_back, state, actions, step.stack, *bars),
        "push_forward": partial(derivatives.push_forward, state, actions, bars[0], actions),
    }
    times = {name: timing.median for name, timing in timed_in_turn(calls).items()}
    envs.close()
    memory = {name: array.nbytes // state.shape[1]
              for name, array in (("stack", step.stack), ("state", state))}  # fmt: skip
    return {"scene": scene, "seconds": times, **memory}


def pairs() -> list[tuple[Config, Config]]:
    """Shipped experiments whose learner differentiates the arms, each with one of PPO."""
    configs = [load_config(path) for path in shipped_experiments().values()]
    return [
        (ours, theirs)
        for ours in configs
        for theirs in configs
        if ours.agent.name in DIFFERENTIATED
        and theirs.name == ours.name.replace(ours.agent.name, "ppo")
    ]


def trained(config: Config, work: Path) -> dict[str, Any]:
    """A run of an experiment: steps, seconds, and means of test episodes."""
    run, seconds = run_seed(config, work / config.name, config.seed)
    test = replace(config.evaluation, seed=FIRST, episodes=EPISODES)
    found = episode_metrics(recorded(replace(config, evaluation=test), run.policy))
    means = {name: float(np.nanmean(found[name])) for name in ("score", "settling_time", "success")}
    return {
        "env": titled(config.env.id, config.env.kwargs),
        "learner": config.agent.name,
        "steps": config.total_steps,
        "seconds": seconds,
        **means,
    }


def page(results: dict[str, Any]) -> str:
    """Markdown page of the results."""
    machine = results["provenance"]["machine"]
    costs = [
        [
            f"{ENVIRONMENTS} {x['scene']}",
            f"{1e6 * x['seconds']['step']:.0f}",
            *(
                f"{x['seconds'][name] / x['seconds']['step']:.2f}"
                for name in ("record", "pull_back", "push_forward")
            ),
            *(f"{1e-3 * x[name]:.2g}" for name in ("stack", "state")),
        ]
        for x in results["costs"]
    ]
    runs = [
        [
            x["env"],
            x["learner"],
            f"{x['steps']:,}",
            f"{x['seconds']:.0f}",
            f"{x['score']:.3f}",
            f"{x['settling_time']:.2f}",
            f"{100.0 * x['success']:.0f}",
        ]
        for x in results["runs"]
    ]
    return f"""# Gradients through the step

Made by `{results["provenance"]["command"]}` on {machine["processor"]}, {machine["cores"]} cores.

Median times in one thread. Recorded, pulled back and pushed forward are in units of the step; the
stack is what a recorded step keeps for each environment beside its state.

{table(COSTS, costs, "l")}

One seed of each experiment. Means of {EPISODES} episodes from seed {FIRST} on.

{table(LEARNERS, runs, "ll")}
"""


def main() -> None:
    """Command line."""
    parser = argument_parser("training.gradients", __doc__, "gradients.json")
    parser.add_argument("--keep", type=Path, help="folder of the runs, which go on from there")
    a = parser.parse_args()
    costs = [cost(scene) for scene in SCENES]
    with tempfile.TemporaryDirectory() as temporary:
        work = a.keep or Path(temporary)
        runs = [trained(config, work) for pair in pairs() for config in pair]
    about = provenance("flexarm", "numba", "torch", "stable_baselines3")
    results = {"costs": costs, "runs": runs, "provenance": about}
    save_results(results, page, a.out)


if __name__ == "__main__":
    main()
