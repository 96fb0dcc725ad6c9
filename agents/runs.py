"""A run's folder: what lies where, and the log that survives a kill."""

import csv
import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml

from agents.config import Config, ConfigError, load_config
from agents.evaluation import without_infinities, write_json

PACKAGES = "flexarm numpy scipy numba casadi gymnasium stable_baselines3 torch matplotlib pillow"
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
        """The same network before its first update."""
        return self.path / "untrained"

    def read_config(self) -> Config:
        """The experiment of this run."""
        if not self.config.is_file():
            raise ConfigError(f"{self.path}: is not a run (it holds no config.yaml).")
        return load_config(self.config)

    def write_config(self, config: Config) -> None:
        """Keep the experiment, complete with its defaults."""
        text = yaml.safe_dump(config.to_dict(), sort_keys=False)
        temporary = self.config.with_suffix(".tmp")
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, self.config)

    def write_versions(self, **more: Any) -> None:
        """What this run was made with."""
        write_json(self.path / "versions.json", versions() | more)

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row to the log in a single write, so that a kill cannot tear it."""
        line = json.dumps(without_infinities(row), allow_nan=False) + "\n"
        descriptor = os.open(self.log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            os.write(descriptor, line.encode())
        finally:
            os.close(descriptor)

    def rows(self) -> list[dict[str, Any]]:
        """Every row of the log; a last line torn by a power failure is passed over."""
        if not self.log.exists():
            return []
        rows = []
        for line in self.log.read_text(encoding="utf-8").splitlines():
            try:
                rows.append(json.loads(line))
            except json.JSONDecodeError:
                continue
        return rows

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
        with open(self.path / "metrics.csv", "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, CURVE_COLUMNS.split(), extrasaction="ignore")
            writer.writeheader()
            writer.writerows(self.curve())


def new_run(out: Path | None, config: Config) -> RunFolder:
    """An empty folder for a run: `out`, or runs/NAME/seedN with a number if that is taken."""
    if out is None:
        base = Path("runs") / config.name
        names = [f"seed{config.seed}"] + [f"seed{config.seed}-{i}" for i in range(2, 10_000)]
        out = next(base / name for name in names if not (base / name).exists())
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise ConfigError(f"{out}: is not empty; choose another --out, or --resume {out}.")
    except OSError as error:
        raise ConfigError(f"{out}: cannot be used as a run folder ({error.strerror}).") from None
    return RunFolder(out)


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
