"""Profile of a training by PPO on the processor: where the time of its steps goes.

    python -m benchmarks.training.learning

Trains the experiment of the README, on one and two threads, and with more epochs on smaller
batches. Writes docs/results/learning.json and .md.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from agents.config import Config, load_config
from agents.training import build_model
from benchmarks.output import ROOT, argument_parser, count, provenance, save_results, table

CONFIG = ROOT / "configs" / "one_link_reach_ppo.yaml"
CASES: dict[str, tuple[int, dict[str, int]]] = {  # threads, other keywords of the learner
    "one thread": (1, {}),
    "two threads": (2, {}),
    "6 epochs on 2,048": (1, {"n_epochs": 6, "batch_size": 2048}),
}
REST = "rest: buffers, losses, clipping, statistics"
HEADER = """# Where the time of a training goes

Made by `{command}` on {processor}, {cores} cores.

`{config}`: {parallel} environments in one compiled batch, {epochs} epochs on minibatches of
{batch:,}. Microseconds per step of training, and their share. `flexarm train` uses one thread of
torch.

{table}
"""


class Clock:
    """Seconds that calls of methods take, by part."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def watch(self, owner: Any, method: str, part: str) -> None:
        """Add the time of a method to a part; calls of one part do not nest in another's."""
        call: Callable[..., Any] = getattr(owner, method)

        def watched(*arguments: Any, **keywords: Any) -> Any:
            begin = time.perf_counter()
            try:
                return call(*arguments, **keywords)
            finally:
                self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - begin

        setattr(owner, method, watched)


def profiled(config: Config, threads: int) -> dict[str, float]:
    """Microseconds per step of training by part, after a first rollout that compiles."""
    import torch

    torch.set_num_threads(threads)
    model, clock = build_model(config), Clock()
    rollout = config.env.n_envs * config.agent.kwargs["n_steps"]
    model.learn(rollout)
    backward = torch.Tensor.backward
    try:
        clock.watch(model.env, "step", "environment")
        clock.watch(model.policy, "forward", "policy, to act")
        clock.watch(model.policy, "evaluate_actions", "forward, to learn")
        clock.watch(torch.Tensor, "backward", "backward")
        clock.watch(model.policy.optimizer, "step", "Adam")
        begin = time.perf_counter()
        model.learn(config.total_steps, reset_num_timesteps=False)
        whole = time.perf_counter() - begin
    finally:
        torch.Tensor.backward = backward
    steps = model.num_timesteps - rollout
    parts = clock.seconds | {REST: whole - sum(clock.seconds.values()), "whole": whole}
    return {part: 1e6 * seconds / steps for part, seconds in parts.items()}


def main() -> None:
    """Profile the experiment and write the page."""
    parser = argument_parser("training.learning", __doc__, "learning.json")
    parser.add_argument("--steps", type=count, default=500_000)
    a = parser.parse_args()
    config = replace(load_config(CONFIG), total_steps=a.steps)
    found = {}
    for name, (threads, changes) in CASES.items():
        agent = replace(config.agent, kwargs=config.agent.kwargs | changes)
        found[name] = profiled(replace(config, agent=agent), threads)
    about = provenance("torch", "stable-baselines3")
    rows = [
        [part, *(f"{x[part]:.2f} ({x[part] / x['whole']:.0%})" for x in found.values())]
        for part in found["one thread"]
    ]
    rows.append(["steps per second", *(f"{1e6 / x['whole']:,.0f}" for x in found.values())])
    page = HEADER.format(
        command=about["command"], processor=about["machine"]["processor"],
        cores=about["machine"]["cores"], config=CONFIG.relative_to(ROOT),
        parallel=config.env.n_envs, epochs=config.agent.kwargs["n_epochs"],
        batch=config.agent.kwargs["batch_size"],
        table=table(["part", *found], rows, "lrrr"),
    )  # fmt: skip
    save_results(about | {"steps": a.steps, "microseconds": found}, page, a.out)


if __name__ == "__main__":
    main()
