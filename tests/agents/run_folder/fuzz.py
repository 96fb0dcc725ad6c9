"""Random damages, kills and full disks, each followed by `--resume`; prints the outcomes.

    python -m tests.agents.run_folder.fuzz --damages 200 --kills 100 --starts 30 --full 40 --seed 0

A run may refuse to continue, with one sentence, but must never end with a traceback or lose a row.
"""

import argparse
import json
import resource
import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from agents import training
from agents.policy import load_policy
from agents.run_folder import callback
from agents.run_folder.checkpoints import newest_intact
from agents.run_folder.folder import RunFolder
from agents.run_folder.log import parsed
from agents.signals import Interrupted
from tests.agents.run_folder.damages import DAMAGES, Rng
from tests.agents.run_folder.forks import PLACES, TRACEBACK, Ending, forked, place_kill
from tests.agents.tiny import write_config

STEPS = {"ppo": 1024, "sac": 128}  # of the runs before the damage
MORE = {"ppo": 1024, "sac": 64}  # further steps after it
IN_MEMORY = Path("/dev/shm")  # fsync is fast here; a kill loses no data of the system's memory


@dataclass
class Report:
    """Counts of outcomes, and faults."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def require(self, holds: bool, case: str, claim: str, ending: Ending | None = None) -> None:
        """Add a fault unless the claim holds."""
        if not holds:
            said = "" if ending is None else f": {ending.status} {ending.errors[-400:]}"
            self.faults.append(f"{case}: not {claim}{said}")


def train(*arguments: str | Path) -> int:
    """Run `train.py` in this process."""
    return training.main([str(argument) for argument in arguments])


def template(folder: Path, name: str, *, finished: bool) -> RunFolder:
    """A run with two checkpoints and a log, finished or interrupted before its evaluation."""
    folder.mkdir(parents=True)
    run = RunFolder(folder / "run")
    config = write_config(folder, name, STEPS[name])

    def judge(run: RunFolder, config: Any) -> None:
        if not finished:
            raise Interrupted(2)

    training.judge = judge
    train("--config", config, "--out", run.path)
    training.judge = lambda run, config: None
    assert len(list(run.checkpoints.iterdir())) == 2
    return run


def lines(log: Path, *, rows: bool = True) -> list[bytes]:
    """Lines of the log that are rows, or those that are not."""
    content = log.read_bytes().split(b"\n") if log.is_file() else []
    return [line for line in content if line and (parsed(line) is not None) is rows]


def is_part(few: list[bytes], many: list[bytes]) -> bool:
    """True if all lines of `few` are in `many`, in the same order."""
    rest = iter(many)
    return all(line in rest for line in few)


@dataclass(frozen=True)
class Log:
    """Lines of a log before a damage or kill."""

    path: Path
    rows: list[bytes]
    others: list[bytes]

    def check(self, report: Report, case: str, ending: Ending) -> None:
        """Require that no row is lost, no invalid line is added, and rows can be appended."""
        kept = is_part(self.rows, lines(self.path))
        report.require(kept, case, "with every row kept", ending)
        clean = is_part(lines(self.path, rows=False), self.others)
        report.require(clean, case, "without new lines that are no rows", ending)
        if ending.status in (0, 1):
            ended = self.path.read_bytes()[-1:] == b"\n"
            report.require(ended, case, "with an end of the last line", ending)


def log_of(run: RunFolder) -> Log:
    """Current lines of a run's log."""
    return Log(run.log, lines(run.log), lines(run.log, rows=False))


def check_ending(report: Report, case: str, ending: Ending) -> None:
    """Require success, or a refusal in one sentence."""
    sentences = [line for line in ending.errors.splitlines() if line.startswith("train.py: ")]
    fair = ending.status == 0 or (ending.status in (1, 2) and len(sentences) == 1)
    report.require(fair, case, "a success or one sentence", ending)
    silent = "Traceback" not in ending.errors + ending.output and ending.status != TRACEBACK
    report.require(silent, case, "without a traceback", ending)


def check_finished(report: Report, case: str, run: RunFolder, steps: int) -> None:
    """Require that all parts of a finished run are intact."""
    finished, (newest, flaws) = run.finished_at(), newest_intact(run.checkpoints)
    report.require(finished is not None and finished >= steps, case, "finished")
    intact = newest is not None and not flaws and int(newest.name[5:]) >= steps
    report.require(intact, case, "an intact newest checkpoint at the end")
    report.require(load_policy(run.path).about["steps"] == finished, case, "the trained policy")
    report.require(not list(run.path.rglob(".partial*")), case, "free of partial files")


def is_intact(run: RunFolder) -> bool:
    """True if every file that is written atomically can be read."""
    try:
        run.read_config()
        load_policy(run.policy)
        load_policy(run.untrained)
        json.loads(run.versions.read_text())
    except (OSError, ValueError):
        return False
    return True


def damage(run: RunFolder, rng: Rng) -> list[str]:
    """Apply one to three damages to the run; returns their names."""
    return [damage_once(run, rng) for _ in range(rng.integers(1, 4))]


def damage_once(run: RunFolder, rng: Rng) -> str:
    """Damage a file, mostly the log or one of the newest checkpoint, or remove a folder."""
    inside = sorted(path for path in run.path.rglob("*") if path.parent.name != "tensorboard")
    files = [path for path in inside if path.is_file()]
    folders = [path for path in inside if path.is_dir()]
    steps = [path for path in folders if path.name.startswith("step_")]
    newest = [path for path in files if steps and path.parent == steps[-1]]
    pool = (newest, [path for path in files if path == run.log], files)[rng.integers(3)] or files
    path, draw = pool[rng.integers(len(pool))], rng.random()
    if draw < 0.05 and folders:
        folder = folders[rng.integers(len(folders))]
        shutil.rmtree(folder)
        return f"removed folder {folder.name}"
    if draw < 0.15:
        path.unlink()
        return f"removed {path.name}"
    if draw < 0.2:
        path.write_bytes(files[rng.integers(len(files))].read_bytes())
        return f"swapped {path.name}"
    change = DAMAGES[rng.integers(len(DAMAGES))]
    path.write_bytes(change(path.read_bytes(), rng))
    return f"{change.__name__} {path.name}"


def fuzz_damages(report: Report, work: Path, runs: dict[str, RunFolder], n: int, rng: Rng) -> None:
    """Damage a run, resume it and check the result."""
    for i in range(n):
        kind = ("ppo", "ppo", "ppo", "sac", "finished")[rng.integers(5)]
        name = "ppo" if kind == "finished" else kind
        run = RunFolder(work / "damaged" / "run")
        shutil.rmtree(work / "damaged", ignore_errors=True)
        shutil.copytree(runs[kind].path, run.path)
        done = damage(run, rng)
        report.counts.update(f"damage: {what.rpartition(' ')[0]}" for what in done)
        case = f"damage {i} of {kind} ({', '.join(done)})"
        before, steps = log_of(run), STEPS[name] + MORE[name] // 4
        resume = ["--resume", run.path, "--steps", str(steps)]
        ending = forked(lambda arguments=resume: train(*arguments), work / "words")
        check_ending(report, case, ending)
        before.check(report, case, ending)
        report.counts[f"damaged, status {ending.status}"] += 1
        if ending.status == 0:
            report.require(ending.output.count("Skipped") <= 2, case, "briefly reported", ending)
            check_finished(report, case, run, steps)
            report.counts["damaged, checkpoints skipped"] += ending.output.count("Skipped")
        else:
            blamed = any("config.yaml" in what for what in done)
            report.require(blamed, case, "refused for its config.yaml only", ending)


def fuzz_kills(report: Report, work: Path, runs: dict[str, RunFolder], n: int, rng: Rng) -> None:
    """Kill a continued run, three times of four at a chosen call; resume it."""
    killed = 0
    while killed < n:
        name = ("ppo", "ppo", "ppo", "sac")[rng.integers(4)]
        run = RunFolder(work / "killed" / "run")
        shutil.rmtree(work / "killed", ignore_errors=True)
        shutil.copytree(runs[name].path, run.path)
        before, steps = log_of(run), STEPS[name] + MORE[name]
        resume = ["--resume", run.path, "--steps", str(steps)]
        ending, place = killed_while(resume, work, rng)
        if ending.status != -9:
            report.counts["not killed: no such call"] += 1
            report.require(ending.status == 0, place, "a success without a kill", ending)
            continue
        killed += 1
        case = f"kill {killed} of {name} ({place})"
        report.counts[f"killed {place.split(',')[0]}"] += 1
        newest, flaws = newest_intact(run.checkpoints)
        report.require(not flaws and newest is not None, case, "an intact newest checkpoint")
        report.require(is_part(before.rows, lines(run.log)), case, "with every old row kept")
        report.require(is_intact(run), case, "with intact files", ending)
        before = log_of(run)
        ending = forked(lambda arguments=resume: train(*arguments), work / "words")
        check_ending(report, case, ending)
        report.require(ending.status == 0, case, "resumed", ending)
        before.check(report, case, ending)
        at = int(newest.name[5:]) if newest else 0
        told = f"Resuming at {at:,} of" in ending.output and at >= STEPS[name]
        report.require(told or "is finished" in ending.output, case, "from its newest", ending)
        check_finished(report, case, run, steps)


def killed_while(arguments: list[Any], work: Path, rng: Rng) -> tuple[Ending, str]:
    """Train in a child process that is killed at a chosen call, or after some time."""
    if rng.random() < 0.25:
        after = float(rng.uniform(0.02, 0.5))
        return forked(lambda: train(*arguments), work / "words", after), f"at a time, {after:.2f} s"
    place = PLACES[rng.integers(len(PLACES))]
    times = ("before", "after", "amid") if place[3] else ("before", "after")
    last = 3 if rng.random() < 0.4 else place[2]  # the first calls are those of other files
    call, when = int(rng.integers(1, last + 1)), times[rng.integers(len(times))]

    def dying() -> int:
        place_kill(place, call, when)
        return train(*arguments)

    return forked(dying, work / "words"), f"{when} {place[1]}, call {call}"


def fuzz_starts(report: Report, work: Path, n: int, rng: Rng) -> None:
    """Kill a starting run; repeat the command, or resume if there is a run."""
    killed = 0
    while killed < n:
        shutil.rmtree(work / "started", ignore_errors=True)
        run = RunFolder(work / "started" / "run")
        run.path.parent.mkdir()
        config = write_config(run.path.parent, "ppo", STEPS["ppo"])
        begin = ["--config", config, "--out", run.path]
        ending, place = killed_while(begin, work, rng)
        if ending.status != -9:
            continue
        killed += 1
        begun = run.config.is_file()
        report.counts[f"killed at the start, {'with' if begun else 'without'} a run"] += 1
        case, before = f"start {killed} ({place})", log_of(run)
        again = ["--resume", run.path] if begun else begin
        ending = forked(lambda arguments=again: train(*arguments), work / "words")
        check_ending(report, case, ending)
        before.check(report, case, ending)
        check_finished(report, case, run, STEPS["ppo"])


def fuzz_full(report: Report, work: Path, runs: dict[str, RunFolder], n: int, rng: Rng) -> None:
    """Limit the size of files, as on a full disk; then resume without the limit."""
    for i in range(n):
        run = RunFolder(work / "full" / "run")
        shutil.rmtree(work / "full", ignore_errors=True)
        shutil.copytree(runs["ppo"].path, run.path)
        amid_a_row = run.log.stat().st_size + int(rng.integers(1, 150))
        limit = (amid_a_row, int(rng.integers(2500, 12_000)))[rng.integers(2)]
        steps = STEPS["ppo"] + MORE["ppo"]
        case, resume = f"full {i} ({limit} bytes)", ["--resume", run.path, "--steps", str(steps)]
        before = log_of(run)

        def limited(limit: int = limit, arguments: list[Any] = resume) -> int:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            return train(*arguments)

        ending = forked(limited, work / "words")
        check_ending(report, case, ending)
        report.counts[f"full, status {ending.status}"] += 1
        newest, flaws = newest_intact(run.checkpoints)
        report.require(newest is not None and not flaws, case, "an intact checkpoint", ending)
        report.require(not list(run.path.rglob(".partial*")), case, "free of partial files", ending)
        before.check(report, case, ending)
        report.require(is_intact(run), case, "with intact files", ending)
        ending = forked(lambda arguments=resume: train(*arguments), work / "words")
        report.require(ending.status == 0, case, "resumed", ending)
        check_finished(report, case, run, steps)


def main() -> int:
    """Run the command line; returns 1 if there are faults."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--damages", type=int, default=200)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--starts", type=int, default=30)
    parser.add_argument("--full", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    callback.CHECKPOINT_SHARE = 1e9
    report, rng = Report(), np.random.default_rng(a.seed)
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as temporary:
        work = Path(temporary)
        runs = {name: template(work / name, name, finished=False) for name in ("ppo", "sac")}
        runs["finished"] = template(work / "finished", "ppo", finished=True)
        fuzz_damages(report, work, runs, a.damages, rng)
        fuzz_kills(report, work, runs, a.kills, rng)
        fuzz_starts(report, work, a.starts, rng)
        fuzz_full(report, work, runs, a.full, rng)
    print(json.dumps({"counts": dict(sorted(report.counts.items())), "faults": report.faults}))
    return 1 if report.faults else 0


if __name__ == "__main__":
    sys.exit(main())
