"""Command line of a sweep: trials drawn, trained by Ray Tune and ranked in `sweep.json`.

The first trial is the experiment itself. ASHA stops poor trials early. A trial whose worker or
machine is lost starts again from its newest checkpoint, on another machine if there is one.
"""

import argparse
import os
import shlex
import shutil
import socket
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from agents.config import Config, ConfigError, config_from_dict, load_config
from agents.experiments import find_experiment, shipped_experiments
from agents.files import FolderError, atomic_write, check_folder
from agents.learners.ranges import at_random, drawn
from agents.policy import PolicyError, load_policy
from agents.run_folder.folder import refuse_other_arm, refuse_used
from agents.run_folder.lock import folder_lock
from agents.sentences import one_line, refused
from agents.sweep.trial import DIVERGED, POLICY, REPORTS, train_trial
from agents.training import prepare
from agents.tune.learners import ranges_of
from dynamics.arms import ARMS
from dynamics.description import validate
from dynamics.description.data_file import user_path
from dynamics.extras import installation

TRIALS, SEED = 20, 0  # where the command line says none
MOST_TRIALS = 10_000
RETRIES = 3  # of a trial whose worker was lost
REDUCTION = 3  # ASHA goes on with this part of the trials at each of its steps
SNAPSHOT_SECONDS = "2"  # between Ray Tune's notes of which trials are done
RESULTS, BEST, TUNE, CONFIG = "sweep.json", "best.yaml", "tune", "config.yaml"
INTERRUPTED = 130  # exit status, as a shell has it: Ctrl-C
CONNECT_SECONDS = 5.0  # within which something at the address of a cluster must answer
LOCAL = "local"  # without an address Ray joins any cluster that happens to run here
RAYS_OWN = ("auto", LOCAL)  # addresses that name no machine


class SweepError(ValueError):
    """A sweep that cannot be carried out; the message is one sentence for the user."""


def main(arguments: list[str] | None = None, prog: str = "python -m agents.sweep") -> int:
    """Run the command line; returns the exit status (2 and one sentence for unusable input)."""
    parser = argparse.ArgumentParser(prog=prog, description=__doc__)
    parser.add_argument(
        "config",
        nargs="?",
        metavar="CONFIG",
        help="experiment: a file, or the name of a shipped one",
    )
    parser.add_argument("--trials", type=int, metavar="N", help=f"in all ({TRIALS})")
    parser.add_argument("--seed", type=int, help=f"of the drawn values ({SEED})")
    parser.add_argument("--steps", type=int, help="of every trial (the experiment's)")
    parser.add_argument("--address", metavar="A", help="of a Ray cluster (started on this machine)")
    parser.add_argument(
        "--out", type=user_path, metavar="DIR",
        help="folder of the results (runs/NAME/sweep); all machines of a cluster must reach it",
    )  # fmt: skip
    parser.add_argument("--keep-all", action="store_true", help="stop no trial early")
    parser.add_argument("--resume", type=user_path, metavar="DIR", help="continue the sweep in DIR")
    a = parser.parse_args(arguments)
    try:
        if a.resume is not None:
            refuse_beside_resume(a)
            resume(a.resume, a.address)
        elif a.config is None:
            raise SweepError("an experiment file is needed, such as configs/one_link_damp_ppo.yaml")
        else:
            start(a)
    except (SweepError, ConfigError, FolderError, PolicyError) as error:
        return refused(prog, error)
    except BrokenPipeError:
        return refused(prog, "nobody reads the output; go on by --resume with its folder.", 1)
    except ConnectionError as error:
        return refused(prog, f"no cluster at {a.address} ({one_line(error)}).", 1)
    except OSError as error:
        return refused(prog, f"{one_line(error)}; go on by --resume with its folder.", 1)
    except KeyboardInterrupt:
        return refused(prog, "interrupted; go on by --resume with its folder.", INTERRUPTED)
    return 0


def start(a: argparse.Namespace) -> None:
    """Check and draw everything, then begin the sweep in a new folder."""
    require_ray()
    count, seed = TRIALS if a.trials is None else a.trials, SEED if a.seed is None else a.seed
    for name, value, low, high in (("trials", count, 1, MOST_TRIALS), ("seed", seed, 0, 2**31 - 1)):
        if not low <= value <= high:
            raise SweepError(f"--{name} must be between {low} and {high:_}, got {value}.")
    config = located(load_config(find_experiment(a.config)))
    if a.steps is not None:
        config = config_from_dict(config.to_dict() | {"total_steps": a.steps})
    trials = plan(config, count, seed)
    out = a.out or Path("runs") / config.name / "sweep"
    check_folder(out)
    refuse_begun(out)
    require_cluster(a.address)
    prepare(config, warm=True)
    out.mkdir(parents=True, exist_ok=True)
    with folder_lock(out):
        refuse_begun(out)
        write_yaml(out / CONFIG, config)
        run(out.absolute(), a.address, trials, a.keep_all)


def located(config: Config) -> Config:
    """The experiment with absolute paths of its arm file and the run that it begins with.

    Workers run in other folders.
    """
    arm, warm = config.env.kwargs.get("arm"), config.agent.warm_start
    if isinstance(arm, str) and arm not in ARMS and Path(arm).is_file():
        kwargs = {**config.env.kwargs, "arm": str(Path(arm).absolute())}
        config = replace(config, env=replace(config.env, kwargs=kwargs))
    if warm and warm not in shipped_experiments():
        agent = replace(config.agent, warm_start=str(user_path(warm).absolute()))
        config = replace(config, agent=agent)
    return config


def resume(out: Path, address: str | None) -> None:
    """Continue a sweep whose command was ended; finished trials are kept."""
    require_ray()
    if not (out / TUNE).is_dir():
        raise SweepError(
            f"{out} holds no sweep to resume; begin one by CONFIG --out {shlex.quote(str(out))}."
        )
    for folder in (out / TUNE).glob(f"*/*/{POLICY}"):
        with suppress(PolicyError):
            about = load_policy(folder).about
            refuse_other_arm(about, about["env_kwargs"])
    require_cluster(address)
    with folder_lock(out):
        run(out.absolute(), address, None)


def refuse_beside_resume(a: argparse.Namespace) -> None:
    """Refuse arguments of a new sweep beside `--resume`."""
    given = {
        "CONFIG": a.config, "--trials": a.trials, "--seed": a.seed, "--steps": a.steps,
        "--out": a.out, "--keep-all": a.keep_all or None,
    }  # fmt: skip
    for name, value in given.items():
        if value is not None:
            shown = name if value is True else f"{name} {value}"
            raise SweepError(
                f"{shown} is for a new sweep, and --resume goes on with the plan in {a.resume}; "
                "leave it out."
            )


def refuse_begun(out: Path) -> None:
    """Refuse a folder with a sweep or other files; one of a sweep that never began is free."""
    if (out / TUNE).is_dir():
        refuse_used(out)
    names = [p.name for p in out.iterdir() if not p.name.startswith(".")] if out.is_dir() else []
    if names and not (names == [CONFIG] and is_ours(out / CONFIG)):
        raise FolderError(f"{out}: is not empty and holds no sweep; choose another --out.")


def is_ours(path: Path) -> bool:
    """True for an experiment as `write_yaml` writes it, which no hand has written."""
    try:
        return path.read_text(encoding="utf-8") == as_yaml(load_config(path))
    except (OSError, ValueError):
        return False


def require_cluster(address: str | None) -> None:
    """Refuse an address HOST:PORT at which nothing listens; Ray itself would try for minutes."""
    if address is None or address in RAYS_OWN or "://" in address:
        return
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 2**16:
        raise SweepError(
            f"--address must be HOST:PORT or auto, got {validate.shown(address)}; `ray start "
            "--head` prints that of its cluster."
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_SECONDS).close()
    except (OSError, UnicodeError) as error:
        raise SweepError(
            f"nothing listens at --address {address} ({one_line(error)}); start a cluster there by "
            "`ray start --head`, or leave --address out."
        ) from None


def require_ray() -> None:
    """Refuse to begin without Ray."""
    try:
        import ray.tune  # noqa: F401
    except ImportError:
        raise SweepError(f"Ray is missing; {installation('scale')}") from None


def plan(config: Config, n: int, seed: int) -> list[Config]:
    """The experiment itself and n - 1 others with drawn keywords; an unusable one is refused."""
    ranges, draw = ranges_of(config), at_random(np.random.default_rng(seed))
    plain = replace(config, sweep={})
    trials = [plain]
    while len(trials) < n:
        data = plain.to_dict()
        data["agent"]["kwargs"] |= drawn(ranges, config.agent.kwargs, draw)
        trials.append(config_from_dict(data))
    return trials


def run(
    out: Path, address: str | None, trials: list[Config] | None, keep_all: bool = False
) -> None:
    """Let Ray Tune train the trials, or resume them if None; write the ranking and the best."""
    import ray
    from ray import tune

    from agents.sweep.progress import Ranking

    os.environ.setdefault("RAY_AIR_NEW_OUTPUT", "0")
    os.environ.setdefault("TUNE_GLOBAL_CHECKPOINT_S", SNAPSHOT_SECONDS)
    os.environ.setdefault("TUNE_DISABLE_SIGINT_HANDLER", "1")  # which ends as if all were done
    address = address or os.environ.get("RAY_ADDRESS", LOCAL)
    more = {"include_dashboard": False} if address == LOCAL else {}
    ray.init(address=address, log_to_driver=False, logging_level="ERROR", **more)
    try:
        if trials is None:
            tuner = tune.Tuner.restore(
                str(out / TUNE), trainable=train_trial, resume_unfinished=True, resume_errored=True
            )
        else:
            tuner = new_tuner(out, trials, keep_all, Ranking(RESULTS))
        results = tuner.fit()
    finally:
        ray.shutdown()
    finish(out, results)


def new_tuner(out: Path, trials: list[Config], keep_all: bool, ranking: Any) -> Any:
    """Ray Tune's plan of a new sweep."""
    from ray import tune
    from ray.tune.schedulers import ASHAScheduler, FIFOScheduler

    most = max(trial.total_steps for trial in trials)
    halving = ASHAScheduler(
        time_attr="steps", max_t=2 * most, grace_period=max(1, most // REPORTS),
        reduction_factor=REDUCTION,
    )  # fmt: skip
    scheduler = FIFOScheduler() if keep_all else halving
    planned = [{"number": k, "experiment": trial.to_dict()} for k, trial in enumerate(trials)]
    return tune.Tuner(
        tune.with_resources(train_trial, {"cpu": 1}),
        param_space={"planned": tune.grid_search(planned)},
        tune_config=tune.TuneConfig(metric="objective", mode="max", scheduler=scheduler),
        run_config=tune.RunConfig(
            name=TUNE,
            storage_path=str(out),
            verbose=0,
            callbacks=[ranking],
            failure_config=tune.FailureConfig(max_failures=RETRIES),
            checkpoint_config=tune.CheckpointConfig(num_to_keep=2),
        ),
    )


def finish(out: Path, results: Any) -> None:
    """Write the best trial as an experiment, and copy its policy."""
    reported = [result for result in results if result.metrics and "objective" in result.metrics]
    done = [result for result in reported if DIVERGED not in result.metrics]
    if not done and reported:
        raise SweepError(f"all trials of {out} have diverged; take smaller learning rates.")
    if not done:
        raise SweepError(f"no trial of {out} has reported; the errors are below {out / TUNE}.")
    best = max(done, key=lambda result: result.metrics["objective"])
    config = config_from_dict(best.config["planned"]["experiment"])
    write_yaml(out / BEST, replace(config, name=f"{config.name[:80]}_best"))
    with best.checkpoint.as_directory() as folder:
        shutil.copytree(Path(folder) / POLICY, out / POLICY, dirs_exist_ok=True)
    print(f"Best: score {best.metrics['score']:.3f}. Everything is in {out}/")
    print(f"Train it with: flexarm train {shlex.quote(str(out / BEST))}")


def write_yaml(path: Path, config: Config) -> None:
    """Write an experiment that `flexarm train` accepts."""
    with atomic_write(path) as temporary:
        temporary.write_text(as_yaml(config), encoding="utf-8")


def as_yaml(config: Config) -> str:
    """Text of an experiment's file."""
    return yaml.safe_dump(config.to_dict(), sort_keys=False)
