"""Trials per hour and RLlib's throughput on one local Ray node and on two.

    python -m benchmarks.training.cluster

Each node is a process group of this machine with one processor, so two nodes need two free cores.
"""

import importlib.util
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.output import ROOT, argument_parser, count, provenance, save_results, table
from dynamics.extras import installation

CONFIG = Path("configs") / "one_link_reach_ppo.yaml"
NODES = (1, 2)
RUNNER_STEPS = 131_072  # sampled by RLlib, REPEATS times
REPEATS = 5
CALL_STEPS = 8_192  # of one worker in one call
HEADER = """# Cluster: one node against two

`{command}` on {processor}, {cores} cores. A node has one processor and shares the machine with the
other one; a network is not part of the measurement.

{table}

Sweep: {trials} trials of {steps:,} steps of `{config}`, none stopped early, start
of the workers included. RLlib: environment steps per second while workers sample (median of
{repeats} times {runner_steps:,} steps), one worker per node with 64 environments in one batch.
"""


def sweep_seconds(address: str, trials: int, steps: int) -> float:
    """Wall time [s] of a sweep on the cluster at the address."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "agents.sweep", str(CONFIG), "--trials", str(trials)]
        command += ["--steps", str(steps), "--address", address, "--keep-all", "--out"]
        begin = time.monotonic()
        subprocess.run([*command, f"{folder}/out"], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        return time.monotonic() - begin


def sample(runner: Any) -> None:
    """Let one of RLlib's workers sample, and drop the episodes."""
    runner.sample(num_timesteps=CALL_STEPS)


def sampled_per_second(address: str, runners: int) -> float:
    """Environment steps per second that RLlib's workers sample together."""
    import gymnasium as gym
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig

    ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    try:
        config = (
            PPOConfig()
            .environment("flexarm_env:FlexArm/OneLink-Reach-v0")
            .env_runners(
                num_env_runners=runners,
                num_envs_per_env_runner=64,
                gym_env_vectorize_mode=gym.VectorizeMode.VECTOR_ENTRY_POINT,
            )
            .debugging(log_level="ERROR")
        )
        group = config.build_algo().env_runner_group
        group.foreach_env_runner(sample, local_env_runner=False)  # compiles
        calls = RUNNER_STEPS // (CALL_STEPS * runners)
        seconds = []
        for _ in range(REPEATS):
            begin = time.monotonic()
            for _ in range(calls):
                group.foreach_env_runner(sample, local_env_runner=False)
            seconds.append(time.monotonic() - begin)
        return RUNNER_STEPS / statistics.median(seconds)
    finally:
        ray.shutdown()


def measured(nodes: int, trials: int, steps: int) -> dict[str, Any]:
    """Both measurements on a local cluster of this number of nodes."""
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 100 * 2**20}
    cluster = Cluster(initialize_head=True, head_node_args=node | {"include_dashboard": False})
    try:
        for _ in range(nodes - 1):
            cluster.add_node(**node)
        cluster.wait_for_nodes()
        seconds = sweep_seconds(cluster.address, trials, steps)
        speed = sampled_per_second(cluster.address, nodes)
    finally:
        cluster.shutdown()
    return {"nodes": nodes, "sweep_seconds": seconds, "sampled_per_second": speed}


def main() -> None:
    """Measure on one node and two, and write docs/results/cluster.md."""
    parser = argument_parser("training.cluster", __doc__, "cluster.json")
    parser.add_argument("--trials", type=count, default=6)
    parser.add_argument("--steps", type=count, default=100_000, help="of every trial")
    a = parser.parse_args()
    if importlib.util.find_spec("ray") is None:
        sentence = f"needs ray, which is not installed; {installation('scale')}"
        sys.exit(f"benchmarks.training.cluster {sentence}")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    measured(1, trials=1, steps=CALL_STEPS)  # compiles and fills the caches
    runs = [measured(nodes, a.trials, a.steps) for nodes in NODES]
    about = provenance("ray", "torch", "stable-baselines3")
    about["load"] = os.getloadavg()
    rows = [
        (
            str(run["nodes"]),
            f"{run['sweep_seconds']:.0f}",
            f"{3600 * a.trials / run['sweep_seconds']:.0f}",
            f"{run['sampled_per_second']:,.0f}",
        )
        for run in runs
    ]
    header = ("nodes", "sweep [s]", "trials per hour", "RLlib steps per second")
    text = HEADER.format(
        command=about["command"], processor=about["machine"]["processor"],
        cores=about["machine"]["cores"], table=table(header, rows, "r"), trials=a.trials,
        steps=a.steps, config=CONFIG, repeats=REPEATS, runner_steps=RUNNER_STEPS,
    )  # fmt: skip
    save_results(about | {"trials": a.trials, "steps": a.steps, "runs": runs}, text, a.out)


if __name__ == "__main__":
    main()
