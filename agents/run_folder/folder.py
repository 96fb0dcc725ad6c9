"""A run's folder: what lies where, and the log that survives a kill."""

import csv
import itertools
import platform
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
from agents.files import FolderError, check_folder, written_whole
from agents.metrics import without_infinities, write_json
from agents.run_folder.log import append_row, is_count, mend_log, read_rows
from dynamics.description.data_file import read_mapping

PACKAGES = "flexarm numpy scipy numba casadi gymnasium stable_baselines3 torch matplotlib pillow"
FINISHED = "finished_at_steps"  # key in versions.json, written last
CURVE_COLUMNS = "session steps seconds episodes return tip_error settled failed steps_per_second"


@dataclass(frozen=True)
class RunFolder:
    """The names inside a run's folder."""

    path: Path

    @property
    def config(self) -> Path:
        """The experiment as it was run."""
        return self.path / "config.yaml"

    @property
    def versions(self) -> Path:
        """Versions of Python and packages; FINISHED stands in it once the run is."""
        return self.path / "versions.json"

    @property
    def log(self) -> Path:
        """One JSON row per line, appended and flushed while training."""
        return self.path / "metrics.jsonl"

    @property
    def checkpoints(self) -> Path:
        """Complete states to resume from."""
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
        """The experiment of this run."""
        return load_config(self.config)

    def write_config(self, config: Config) -> None:
        """Keep the experiment, complete with its defaults."""
        text = yaml.safe_dump(config.to_dict(), sort_keys=False)
        with written_whole(self.config) as path:
            path.write_text(text, encoding="utf-8")

    def write_versions(self, more: Mapping[str, Any]) -> None:
        """Keep the versions of all that the run is made with, and more about it."""
        write_json(self.versions, versions() | dict(more))

    def finished_at(self) -> int | None:
        """Steps of a run that was trained and judged to its end; None before."""
        try:
            steps = read_mapping(self.versions).get(FINISHED)
        except ValueError:
            return None
        return steps if is_count(steps) else None

    def refuse_links(self) -> None:
        """Refuse a folder from which writing would lead elsewhere."""
        for path in self.path.rglob("*"):
            if path.is_symlink() or not (path.is_file() or path.is_dir()):
                raise FolderError(
                    f"{path}: is a link or a device, and a run has files of its own only; put a "
                    "copy in its place."
                )

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row to the log."""
        append_row(self.log, without_infinities(row))

    def rows(self) -> list[dict[str, Any]]:
        """Every row of the log."""
        return read_rows(self.log)[0]

    def mend_log(self) -> list[str]:
        """Make the log ready for more rows; returns a sentence about each thing that is wrong."""
        sentences = [mend_log(self.log)]
        strange = read_rows(self.log)[1]
        if strange:
            sentences.append(f"{self.log}: passed over lines that are no rows ({strange} of them).")
        return [sentence for sentence in sentences if sentence]

    def curve(self) -> list[dict[str, Any]]:
        """The rows of the learning curve: where a resumed session repeats steps, the later one."""
        curve: list[dict[str, Any]] = []
        for row in self.rows():
            while curve and curve[-1]["steps"] >= row["steps"]:
                curve.pop()
            curve.append(row)
        return curve

    def write_curve(self) -> None:
        """`metrics.csv` beside the log, for spreadsheets."""
        with (
            written_whole(self.path / "metrics.csv") as path,
            open(path, "w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, CURVE_COLUMNS.split(), extrasaction="ignore")
            writer.writeheader()
            writer.writerows(self.curve())


def check_out(out: Path | None) -> None:
    """Refuse a folder that a new run cannot have, and make nothing."""
    check_folder(out or Path("runs"))
    if out is not None:
        refuse_used(out)


def refuse_used(out: Path) -> None:
    """Refuse a folder with anything but hidden files, such as its lock."""
    if out.is_dir() and any(not path.name.startswith(".") for path in out.iterdir()):
        raise FolderError(f"{out}: is not empty; choose another --out, or --resume {out}.")


def new_run(out: Path | None, config: Config) -> RunFolder:
    """The folder of a run: `out`, or runs/NAME/seedN with a number if that is taken."""
    base = Path("runs") / config.name
    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            return RunFolder(out)
        base.mkdir(parents=True, exist_ok=True)
        for i in itertools.count(1):
            path = base / f"seed{config.seed}{f'-{i}' if i > 1 else ''}"
            with suppress(FileExistsError):  # also if another process makes it just now
                path.mkdir()
                break
        return RunFolder(path)
    except OSError as error:
        raise FolderError(f"{out or base}: cannot be made ({error.strerror}).") from None


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
    """The git commit of the source, with '+' where files differ from it; None outside git."""
    root = Path(__file__).resolve().parents[1]

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
