"""Everything that is learned, ranked, filmed and charted, made again in its order.

    python -m benchmarks.results --list
    python -m benchmarks.results [--only PART ...] [--jobs 2] [--keep runs/results]

A step is a command of its own. Those that have ended are not begun again, and a stopped one goes on
where its command can: trainings, searches and bounds keep what they have. `--list` shows what
remains, how long trainings took when their results were stored, and how long each step took now.
Another --keep, or none of that name, begins anew.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from agents.config import load_config
from agents.experiments import shipped_experiments
from agents.files import write_json
from agents.learners.algorithms import ON_TENSORS
from benchmarks.output import ROOT, argument_parser, count, table
from benchmarks.ranking.harder import REACH as WIDE
from benchmarks.training.experiments import stored_seconds
from benchmarks.training.studies import STUDIES
from dynamics.description import validate

KEEP = Path("runs") / "results"
FILMS = Path("docs") / "envs" / "films"
DEFAULT_SEEDS = (0, 1, 2)  # of an experiment without results
DONE = "done.json"  # in --keep: seconds of the steps that have ended


@dataclass(frozen=True)
class Step:
    """One command, `python -m` and its words."""

    part: str
    words: tuple[str, ...]  # name the step
    options: tuple[str, ...] = ()  # of this run: processes and folders
    minutes: float | None = None  # expected from stored results
    on_gpu: bool = False  # whether `device: cuda` in its experiment file shortens it

    @property
    def text(self) -> str:
        """The words in one line."""
        return " ".join(self.words)


def steps(jobs: int, keep: Path) -> Iterator[Step]:
    """All steps, each after those whose results it reads."""
    side = ("--jobs", str(jobs))
    for track in ("state", "laboratory"):
        yield Step("bounds", ("agents.leaderboard.bound", "--track", track), side)
    yield Step("parameters", ("agents.tune",), ("--keep", str(keep / "tune")))
    wide = ("--tasks", WIDE, "--tracks", "wide")
    yield Step("parameters", ("agents.tune", *wide), ("--keep", str(keep / "tune")))
    configs = {name: load_config(path) for name, path in shipped_experiments().items()}
    for name, config in sorted(configs.items(), key=lambda x: bool(x[1].agent.warm_start)):
        took = stored_seconds(name)
        seeds = took or DEFAULT_SEEDS
        given = ("--config", f"configs/{name}.yaml", "--ship", "--seeds", *map(str, seeds))
        kept = (*side, "--keep", str(keep / name))
        on_tensors = config.agent.name in ON_TENSORS
        minutes = sum(took.values()) / 60.0 / jobs if took else None
        yield Step("trainings", ("benchmarks.training", *given), kept, minutes, on_tensors)
    yield Step("trainings", ("benchmarks.training.distilled",))
    for name, study in STUDIES.items():
        on_tensors = load_config(study.learner).agent.name in ON_TENSORS
        yield Step("studies", ("benchmarks.training.studies", name), side, on_gpu=on_tensors)
    yield Step("ranking", ("agents.leaderboard",), (*side, "--out", "docs/results"))
    for name in ("on_reference", "knowledge"):
        yield Step("ranking", (f"benchmarks.ranking.{name}",), side)
    yield Step("ranking", ("benchmarks.ranking.harder",))
    yield Step("films", ("agents.films",), ("--out", str(FILMS)))
    for name in ("training.experiments", "ranking.standings"):
        yield Step("tables", (f"benchmarks.{name}",))


def done(keep: Path) -> dict[str, float]:
    """Seconds of the steps that have ended, by their text."""
    file = keep / DONE
    found: dict[str, float] = json.loads(file.read_text("utf-8")) if file.exists() else {}
    return found


def listed(chosen: list[Step], ended: dict[str, float]) -> str:
    """Table of the steps."""
    rows = []
    for x in chosen:
        took = f"{ended[x.text] / 60.0:.1f}" if x.text in ended else "to do"
        expected = "" if x.minutes is None else f"{x.minutes:.1f}"
        rows.append([x.part, x.text, expected, took, "yes" if x.on_gpu else ""])
    header = ["part", "python -m", "expected [min]", "took [min]", "shortened by a GPU"]
    return table(header, rows, "llrrl")


def main(arguments: list[str] | None = None) -> int:
    """Command line; the exit status is that of the first step that fails."""
    parser = argument_parser("results", __doc__)
    parser.add_argument("--only", nargs="+", metavar="PART")
    parser.add_argument("--jobs", type=count, default=os.cpu_count() or 1)
    parser.add_argument("--keep", type=Path, default=KEEP)
    parser.add_argument("--list", action="store_true", help="show the steps, run none")
    options = parser.parse_args(arguments)
    chosen = list(steps(options.jobs, options.keep))
    parts = list(dict.fromkeys(x.part for x in chosen))
    for part in options.only or ():
        try:
            validate.known(part, "part of --only", parts)
        except ValueError as error:
            parser.error(str(error))
    chosen = [x for x in chosen if options.only is None or x.part in options.only]
    if options.list:
        print(listed(chosen, done(options.keep)))
        return 0
    for k, step in enumerate(chosen, 1):
        ended = done(options.keep)
        if step.text in ended:
            continue
        print(f"{k} of {len(chosen)}: python -m {step.text}", flush=True)
        begin = time.monotonic()
        status = subprocess.run(
            [sys.executable, "-m", *step.words, *step.options], cwd=ROOT, check=False
        )
        if status.returncode:
            print(f"Step {k} failed; the same command begins again with it.", file=sys.stderr)
            return status.returncode
        write_json(options.keep / DONE, ended | {step.text: time.monotonic() - begin})
    return 0


if __name__ == "__main__":
    sys.exit(main())
