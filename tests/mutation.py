"""`python -m tests.mutation`: does a test fail when the recursion or the judge is wrong?

Cosmic Ray changes one operator, number or decorator of a module at a time and runs that module's
quick tests, which have to fail. Everything happens in a copy of the sources. Writes
docs/results/mutation.md. One run takes more than an hour on one core.

    pip install cosmic-ray
    python -m tests.mutation [--modules FILE ...] [--out FILE] [--work FOLDER]

A second run with the same `--work` goes on where the first was stopped. Modules that are left out
keep their lines of the page.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tests.paths import ROOT

COPIED = ("agents", "benchmarks", "dynamics", "flexarm_env", "tests", "pyproject.toml")
TIMEOUT = 60.0  # [s] of the tests of a mutant; a loop without an end is found by it
PYTEST = "-m pytest -x -q -p no:cacheprovider -p no:hypothesispytest"
LEFT_OUT = [  # operators that no program would survive: bits of floats, unions of types, identity
    r"core/ReplaceBinaryOperator_BitOr_",
    r"core/ReplaceBinaryOperator_BitAnd_(?!BitOr)",
    r"core/ReplaceBinaryOperator_(?!BitAnd)\w+_(Bit\w+|.Shift|FloorDiv|Mod|Pow)",
    r"core/ReplaceComparisonOperator_(?!Is)\w+_Is",
    r"core/ReplaceUnaryOperator_(USub|Invert)_",
]


@dataclass(frozen=True)
class Judge:
    """A module that is mutated: its tests, and the functions that are not mutated."""

    tests: tuple[str, ...]
    options: str = "--noconftest"  # which imports learning libraries
    without: tuple[str | None, ...] = ()  # None: code outside functions
    equal: dict[str, str] = field(
        default_factory=dict
    )  # mutated line that behaves as the original: why


JUDGES = {
    "dynamics/formulations/gibbs_appell.py": Judge(
        (
            "tests/dynamics/formulations/test_gibbs_appell.py",
            "tests/dynamics/formulations/test_free_base.py",
            "tests/dynamics/formulations/test_parallel_drive.py",
            "tests/dynamics/formulations/test_joints.py",
            "tests/dynamics/formulations/test_fixed_joints.py",
        ),
        options="-m 'quick and not slow'",
        equal={"strict=False": "all are as long"},
    ),
    "flexarm_env/task/rewards.py": Judge(("tests/flexarm_env/task/test_reward_terms.py",)),
    "flexarm_env/task/tasks.py": Judge(
        ("tests/flexarm_env/task/test_tasks.py",),
        equal={"tempo[1] != 0.0": "no frequency is negative"},
    ),
    "agents/metrics.py": Judge(
        ("tests/agents/test_metrics.py",),
        equal={
            "reshape(n_env, - 2)": "NumPy takes any negative length as the open one",
            'name <= "action"': "no other name is before it",
            "reshape(rows[ -1].shape)": "all rows have one shape",
            "time[:, None] >= time[last]": "no sample is 1e-9 s beside the window",
            "recording.duration, 0.0, 2.0)": "no settling time is negative",
            "outside.size <= 0": "no size is negative",
            "first >= error.size": "it is never larger",
            "<= HOLD - 1e-9": "no sample is 1e-9 s beside the least time",
            "allow_nan=True": "no infinity is left",
            'metric >= "tip_error_rms"': "the other one is before it",
        },
    ),
    "agents/leaderboard/statistics.py": Judge(
        ("tests/agents/leaderboard/test_statistics.py",),
        equal={
            "recordings[ -1]": "all recordings have one clock",
            "RESAMPLES, - 2": "NumPy takes any negative length as the open one",
            "EPISODES + 2": "any streams of their own will do",
            "level[:, None], 2, 1": "any stream of its own will do",
            "level[:, None], 1, 2": "one row is drawn from one",
            "level[:, None], 1, 0": "one row is drawn from one",
            "streams, strict=False": "there is one stream per axis",
            "optimize=False": "sums are the same in any order",
            "shape[1],": "episodes are the second of two axes",
        },
    ),
    "agents/leaderboard/bound.py": Judge(
        (
            "tests/agents/leaderboard/test_bound.py",
            "tests/agents/leaderboard/test_stored_bounds.py",
        ),
        without=("main", None),  # the command line; efforts of the search
        equal={
            "rounds != ROUNDS": "rounds are counted one by one",
            "trust >= TRUST[1]": "0.5 is never quartered to 0.01",
            "[None])[ -1]": "one sequence is followed",
            "np.float64))[ -1]": "one sequence is followed",
            "actions.shape)))[ -1]": "one sequence is followed",
            "strict=False": "all are as long",
            "reshape(- 2, size)": "NumPy takes any negative length as the open one",
            "trust + np.abs(bends)": "trust is below 1: more rows are kept, which change nothing",
            "sum(axis=1) >= MARGIN": "a row at the margin has no excess",
            "flush=False": "the line is only seen later",
            "motion.settled <= 0": "no step is negative",
            "lengths.values())) != 1": "no file is without arrays here",
        },
    ),
    "agents/leaderboard/motions.py": Judge(
        ("tests/agents/leaderboard/test_motions.py",),
        without=("_steps", "_derivatives"),  # of compiled environments: tests/.../test_run.py
        equal={
            "strict=False,": "all are as long",
            "1.0)[ -1])": "the batch has one row",
            '["tip_error"][ -1]': "the batch has one row",
        },
    ),
}


@dataclass(frozen=True)
class Mutant:
    """A changed line of a module, and whether a test noticed."""

    line: int
    before: str
    after: str
    killed: bool


def run(module: str, folder: Path) -> list[Mutant]:
    """Mutants of a module, all tried; the folder keeps the session."""
    judge, name = JUDGES[module], module.replace("/", ".")
    config, session = folder / f"{name}.toml", folder / f"{name}.sqlite"
    copy = folder / f"{name}.copy"
    config.write_text(
        f"""[cosmic-ray]
module-path = "{module}"
timeout = {TIMEOUT}
excluded-modules = []
test-command = "{sys.executable} {PYTEST} {judge.options} {" ".join(judge.tests)}"
[cosmic-ray.distributor]
name = "local"
[cosmic-ray.filters.operators-filter]
exclude-operators = {json.dumps(LEFT_OUT)}
"""
    )
    if not session.exists():
        copy.mkdir()
        for part in COPIED:
            source = ROOT / part
            (shutil.copytree if source.is_dir() else shutil.copy)(source, copy / part)
        tool(copy, "cosmic-ray", "baseline", str(config))
        tool(copy, "cosmic-ray", "init", str(config), str(session))
        tool(copy, "cr-filter-operators", str(session), str(config))
        skip(session, judge.without)
    tool(copy, "cosmic-ray", "exec", str(config), str(session))
    return sorted(mutants(session), key=lambda mutant: mutant.line)


def tool(copy: Path, name: str, *arguments: str) -> None:
    """Run a command of Cosmic Ray in the copy."""
    subprocess.run([str(Path(sys.executable).with_name(name)), *arguments], cwd=copy, check=True)


def database(session: Path) -> Any:
    """Cosmic Ray's session."""
    from cosmic_ray.work_db import WorkDB

    return closing(WorkDB(session, WorkDB.Mode.open))


def skip(session: Path, without: tuple[str | None, ...]) -> None:
    """Skip the mutants of functions."""
    from cosmic_ray.work_item import WorkerOutcome, WorkResult

    with database(session) as db:
        for item in list(db.pending_work_items):
            if item.mutations[0].definition_name in without:
                db.set_result(item.job_id, WorkResult(worker_outcome=WorkerOutcome.SKIPPED))


def mutants(session: Path) -> Iterator[Mutant]:
    """Mutants of a session that were tried."""
    with database(session) as db:
        tried = {job: result for job, result in db.results if result.test_outcome is not None}
        for item in [item for item in db.work_items if item.job_id in tried]:
            result = tried[item.job_id]
            before, after = (
                " ".join(
                    line[1:].strip()
                    for line in result.diff.splitlines()
                    if line.startswith(sign) and not line.startswith(3 * sign)
                )
                for sign in "-+"
            )
            yield Mutant(item.mutations[0].start_pos[0], before, after, result.is_killed)


def harmless(mutant: Mutant, judge: Judge) -> str:
    """Reason why a mutant behaves as the original, or an empty text."""
    return next((why for part, why in judge.equal.items() if part in mutant.after), "")


def rows(module: str, found: list[Mutant]) -> list[str]:
    """Row of a module in the table, and a line for every survivor."""
    survivors = [(m, harmless(m, JUDGES[module])) for m in found if not m.killed]
    same = [(m, reason) for m, reason in survivors if reason]
    alive = [m for m, reason in survivors if not reason]
    count, killed = len(found) - len(same), len(found) - len(same) - len(alive)
    share = f"{100.0 * killed / count:.1f} %"
    return [
        f"| `{module}` | {count} | {killed} | {share} | {len(alive)} | {len(same)} |",
        *(f"- `{module}`, {m.line}: `{m.before}` to `{m.after}`" for m in alive),
        *(f"- `{module}`, {m.line}: `{m.after}`: {reason}" for m, reason in same),
    ]


def page(found: dict[str, list[Mutant]], earlier: str = "") -> str:
    """Markdown page: the share that is killed, and every survivor.

    Modules that were not tried keep their lines of an earlier page.
    """
    lines = [
        line
        for module in JUDGES
        for line in (
            rows(module, found[module])
            if module in found
            else [
                x for x in earlier.splitlines() if x.startswith((f"| `{module}`", f"- `{module}`"))
            ]
        )
    ]
    table = [line for line in lines if line.startswith("|")]
    total, dead = (sum(int(line.split("|")[k]) for line in table) for k in (2, 3))
    survivors = [line for line in lines if line.startswith("-")]
    return f"""# Mutants of the recursion and the judge

Made by `python -m tests.mutation` with Cosmic Ray {version("cosmic-ray")}: one operator, number or
decorator changed at a time; killed by the module's quick tests. Mutants that behave as the original
do not count; their reasons are below.

| module | mutants | killed | share | survivors | behave as the original |
|---|---:|---:|---:|---:|---:|
{chr(10).join(table)}
| all | {total} | {dead} | {100.0 * dead / total:.1f} % | {total - dead} | |

{chr(10).join(survivors)}
"""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation")
    parser.add_argument("--modules", nargs="+", choices=list(JUDGES), default=list(JUDGES))
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "mutation.md")
    parser.add_argument("--work", type=Path, help="folder that keeps the sessions")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.work or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        found = {module: run(module, folder) for module in options.modules}
    earlier = options.out.read_text(encoding="utf-8") if options.out.exists() else ""
    text = page(found, earlier)
    options.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
