"""PPO on a GPU in every ranked task, with the sensors of a laboratory, one after another.

    python -m benchmarks.training.gpu [--seconds 35] [--only ID ...] [--keep FOLDER]

Needs an NVIDIA GPU with the extras `gpu` and `tensors`. A task trains for as many steps as take
`--seconds` at the rate of its first rollouts; the eleven tasks with their compilation are expected
to take under ten minutes. A run in `--keep` that has ended is not trained again, and a stopped one
goes on. Policies are judged on the processor, in the episodes of `benchmarks.training.distilled`.
Writes docs/results/gpu_training_NAME.json and .md, where NAME is that of the GPU.
"""

import json
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import torch

from agents.config import Config, config_from_dict
from agents.leaderboard.kinds import CLASSICAL
from agents.leaderboard.output import best_of_each, ranked
from agents.leaderboard.tracks import RANKED, TRACKS
from agents.metrics import make_batch
from agents.policy import load_policy
from agents.run_folder.folder import RunFolder
from agents.sentences import one_line
from agents.training import build_model
from benchmarks.output import RESULTS, argument_parser, paragraphs, provenance, save_results, table
from benchmarks.speed.gpu import require_gpu, slug
from benchmarks.training.distilled import EPISODES, FIRST, score
from benchmarks.training.runs import run_seed
from dynamics.description import validate

Row = dict[str, Any]
TRACK = "laboratory"
PARALLEL = 8192  # environments
PROBE = 4  # rollouts whose rate is measured, after one that compiles
KWARGS: Row = {
    "n_steps": 32, "batch_size": 32_768, "n_epochs": 4, "gamma": 0.99, "gae_lambda": 0.95,
    "learning_rate": "lin_7.0e-4", "std_floor": 0.11,
    "policy_kwargs": {"net_arch": [256, 256], "activation_fn": "tanh", "log_std_init": -0.5},
}  # fmt: skip


def experiment(env_id: str, steps: int, device: str, parallel: int) -> Config:
    """PPO of this task: the latest 24 observations, and a critic that also sees the true state."""
    kwargs = KWARGS | {"batch_size": KWARGS["batch_size"] * parallel // PARALLEL}
    name = env_id.removeprefix("FlexArm/").removesuffix("-v0").lower().replace("-", "_")
    settings = {
        "env": {"id": env_id, "kwargs": TRACKS[TRACK].kwargs, "n_envs": parallel, "stack": 24},
        "agent": {"name": "rsl-ppo", "kwargs": kwargs},
        "total_steps": steps,
        "device": device,
    }
    return config_from_dict(settings, name=f"{name}_gpu")


def affordable(env_id: str, seconds: float, device: str, parallel: int) -> int:
    """Steps of a training that takes about this many seconds: whole rollouts."""
    rollout = KWARGS["n_steps"] * parallel
    model = build_model(experiment(env_id, PROBE * rollout, device, parallel))
    model.learn(rollout, log_interval=None)
    begin = time.perf_counter()
    model.learn(PROBE * rollout, log_interval=None)
    each = (time.perf_counter() - begin) / PROBE
    model.env.close()
    return rollout * max(1, round(seconds / each))


def trained(env_id: str, seconds: float, device: str, keep: Path, parallel: int) -> Row:
    """Steps, time and policy of one task's training."""
    work = keep / env_id.removeprefix("FlexArm/")
    begun = RunFolder(work / "seed0")
    if begun.config.exists():
        config = begun.read_config()
    else:
        steps = affordable(env_id, seconds, device, parallel)
        config = experiment(env_id, steps, device, parallel)
    run, took = run_seed(config, work, 0)
    return {"env": env_id, "steps": config.total_steps, "seconds": took, "policy": run.policy}


def judged(row: Row) -> Row:
    """The row of a training with the policy's score, beside the best classical controller's."""
    with closing(make_batch(row["env"], EPISODES, TRACKS[TRACK].kwargs)) as envs:
        mean = float(score(load_policy(row.pop("policy")), envs).mean())
    best, theirs = best_classical(row["env"])
    return row | {"score": mean, "classical": best, "classical_score": theirs}


def best_classical(env_id: str) -> tuple[str, float]:
    """Best classical controller of the stored ranking, and its mean score."""
    stored = json.loads((RESULTS / "leaderboard.json").read_text(encoding="utf-8"))
    found = ranked(stored[env_id][TRACK])
    best = best_of_each(found)[CLASSICAL]
    return best, found[best]["score_mean"]


def page(results: Row) -> str:
    """Markdown page of the results."""
    rows = [
        [
            x["env"], f"{x['steps']:,}", f"{x['seconds']:.0f}", f"{x['steps'] / x['seconds']:.3g}",
            f"{x['score']:.3f}", f"{x['classical']} {x['classical_score']:.3f}",
        ]
        for x in results["rows"]
    ]  # fmt: skip
    header = ["task", "steps", "training [s]", "steps/s", "PPO", "best classical"]
    return paragraphs(
        f"# PPO on an {results['gpu']}",
        f"Made by `{results['provenance']['command']}`, one seed.",
        f'`hardware="{TRACK}"`. Scores of PPO are means over {EPISODES} episodes from seed {FIRST} '
        "on, those of classical controllers means over the episodes of the [ranking]"
        "(leaderboard.md).",
        table(header, rows, "lrr"),
    )


def measure(
    tasks: Sequence[str], seconds: float, device: str, keep: Path, parallel: int = PARALLEL
) -> Row:
    """A row of every task; all are trained before the first is judged."""
    rows = [trained(env_id, seconds, device, keep, parallel) for env_id in tasks]
    return {"rows": list(map(judged, rows))}


def main(arguments: list[str] | None = None) -> None:
    """Train, judge and write; without a GPU, say so."""
    parser = argument_parser("training.gpu", __doc__)
    parser.add_argument("--seconds", type=float, default=35.0, help="of a task's training")
    parser.add_argument("--only", nargs="+", choices=RANKED, default=RANKED, metavar="ID")
    parser.add_argument("--keep", type=Path, help="folder of the runs, which go on from there")
    options = parser.parse_args(arguments)
    try:
        validate.positive(options.seconds, "--seconds", "s")
    except ValueError as error:
        parser.error(one_line(error))
    require_gpu(parser, "python train.py configs/one_link_reach_ppo.yaml trains without one")
    with tempfile.TemporaryDirectory() as temporary:
        keep = options.keep or Path(temporary)
        results = measure(options.only, options.seconds, "cuda", keep)
    results |= {"gpu": torch.cuda.get_device_name()}
    results["provenance"] = provenance("flexarm", "torch", "rsl-rl-lib")
    save_results(results, page, RESULTS / f"gpu_training_{slug(results['gpu'])}.json")


if __name__ == "__main__":
    main()
