"""Folder of a training run: paths and contents of its files, and provenance."""

import csv
import itertools
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml

from agents.config import Config, load_config
from agents.files import (
    FolderError,
    atomic_write,
    check_folder,
    digest,
    without_infinities,
    write_json,
)
from agents.policy import PolicyError, load_policy
from agents.run_folder.log import append_row, is_count, read_rows, repair_log
from dynamics.description.data_file import read_mapping

PACKAGES = "flexarm numpy scipy numba casadi gymnasium stable_baselines3 sb3_contrib torch "
PACKAGES += "matplotlib pillow"
FINISHED = "finished_at_steps"  # key in versions.json, written last
ARM = "arm_sha256"  # key in the description of a policy: of its arm file, if it names one
CURVE_COLUMNS = "session steps seconds episodes return tip_error settled failed steps_per_second"


@dataclass(frozen=True)
class RunFolder:
    """Paths in a run's folder, and functions that read and write its files."""

    path: Path

    @property
    def config(self) -> Path:
        """The experiment, with overrides and defaults."""
        return self.path / "config.yaml"

    @property
    def versions(self) -> Path:
        """Versions of Python and packages; has the key FINISHED once the run is finished."""
        return self.path / "versions.json"

    @property
    def log(self) -> Path:
        """Training log, one JSON row per line."""
        return self.path / "metrics.jsonl"

    @property
    def checkpoints(self) -> Path:
        """Complete states for resuming."""
        return self.path / "checkpoints"

    @property
    def policy(self) -> Path:
        """The trained policy: weights plus JSON."""
        return self.path / "policy"

    @property
    def untrained(self) -> Path:
        """The network before its first update."""
        return self.path / "untrained"

    def require(self) -> None:
        """Refuse a folder that holds no run."""
        if not self.config.is_file():
            raise FolderError(f"{self.path}: is not a run (it holds no config.yaml).")

    def read_config(self) -> Config:
        """Read the experiment of this run."""
        return load_config(self.config)

    def write_config(self, config: Config) -> None:
        """Write the experiment, including its defaults."""
        text = yaml.safe_dump(config.to_dict(), sort_keys=False)
        with atomic_write(self.config) as path:
            path.write_text(text, encoding="utf-8")

    def write_versions(self, more: Mapping[str, Any]) -> None:
        """Write the versions of the run's software, and the entries of `more`."""
        write_json(self.versions, versions() | dict(more))

    def finished_at(self) -> int | None:
        """Number of steps of a trained and evaluated run; None if it is not finished."""
        try:
            steps = read_mapping(self.versions).get(FINISHED)
        except ValueError:
            return None
        return steps if is_count(steps) else None

    def refuse_other_arm(self, kwargs: Mapping[str, Any]) -> None:
        """Refuse an arm file that has changed since the run began."""
        with suppress(PolicyError):
            refuse_other_arm(load_policy(self.untrained).about, kwargs)

    def refuse_links(self) -> None:
        """Refuse a folder with links or devices, through which writes would leave the folder."""
        for path in self.path.rglob("*"):
            if path.is_symlink() or not (path.is_file() or path.is_dir()):
                raise FolderError(
                    f"{path}: is a link or a device, but a run must have its own files; replace it "
                    "by a copy."
                )

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row to the log."""
        append_row(self.log, without_infinities(row))

    def rows(self) -> list[dict[str, Any]]:
        """Every row of the log."""
        return read_rows(self.log)[0]

    def repair_log(self) -> list[str]:
        """Repair the log before appending rows; returns a sentence per kind of damage."""
        sentences = [repair_log(self.log)]
        invalid = read_rows(self.log)[1]
        if invalid:
            sentences.append(f"{self.log}: skipped lines that are not rows ({invalid} of them).")
        return [sentence for sentence in sentences if sentence]

    def curve(self) -> list[dict[str, Any]]:
        """Rows of the learning curve; a resumed session replaces the steps that it repeats."""
        curve: list[dict[str, Any]] = []
        for row in self.rows():
            while curve and curve[-1]["steps"] >= row["steps"]:
                curve.pop()
            curve.append(row)
        return curve

    def write_curve(self) -> None:
        """Write the learning curve to `metrics.csv`, for spreadsheets."""
        with (
            atomic_write(self.path / "metrics.csv") as path,
            open(path, "w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, CURVE_COLUMNS.split(), extrasaction="ignore")
            writer.writeheader()
            writer.writerows(self.curve())


def check_out(out: Path | None) -> None:
    """Refuse a folder that a new run cannot use, without creating it."""
    check_folder(out or Path("runs"))
    if out is not None:
        refuse_used(out)


def refuse_used(out: Path) -> None:
    """Refuse a folder with files other than hidden ones, such as its lock."""
    if out.is_dir() and any(not path.name.startswith(".") for path in out.iterdir()):
        raise FolderError(
            f"{out}: is not empty; choose another --out, or --resume {shlex.quote(str(out))}."
        )


def new_run(out: Path | None, config: Config) -> RunFolder:
    """Create the folder of a run: `out`, or runs/NAME/seedN with a number if that exists."""
    base = Path("runs") / config.name
    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            return RunFolder(out)
        base.mkdir(parents=True, exist_ok=True)
        for i in itertools.count(1):
            path = base / f"seed{config.seed}{f'-{i}' if i > 1 else ''}"
            with suppress(FileExistsError):  # possibly created by another process meanwhile
                path.mkdir()
                break
        return RunFolder(path)
    except OSError as error:
        raise FolderError(f"{out or base}: cannot be made ({error.strerror}).") from None


def arm_digest(kwargs: Mapping[str, Any]) -> str | None:
    """SHA-256 of the arm file that an environment's keywords name; None if they name none."""
    source = kwargs.get("arm")
    path = Path(os.path.expanduser(source)) if isinstance(source, str) else None
    return digest(path) if path is not None and path.is_file() else None


def refuse_other_arm(about: Mapping[str, Any], kwargs: Mapping[str, Any]) -> None:
    """Refuse an arm file that has changed since the training of a policy, described here, began."""
    if None not in (began := about.get(ARM), now := arm_digest(kwargs)) and began != now:
        raise FolderError(
            f"{kwargs['arm']}: has changed since the training of the policy began; give the file "
            "its former content, or train another policy."
        )


def versions() -> dict[str, Any]:
    """Python, packages, platform, revision and command line."""
    found = {}
    for package in PACKAGES.split():
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": found,
        "revision": revision(),
        "command": ["python", *sys.argv] if sys.argv else [],
    }


def revision() -> str | None:
    """Git commit of the source, with '+' if tracked files differ from it; None outside git."""
    root = Path(__file__).resolve().parents[2]

    def git(arguments: Sequence[str]) -> str:
        command = ["git", "-C", str(root), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        if Path(git(["rev-parse", "--show-toplevel"])).resolve() != root:
            return None
        changed = git(["status", "--porcelain", "--untracked-files=no"])
        return git(["rev-parse", "HEAD"]) + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return None
