"""Progress of a sweep: a line per report, and the ranking on disk after each."""

from pathlib import Path
from typing import Any

from ray.tune import Callback

from agents.files import write_json
from agents.run_folder.folder import versions
from agents.sweep.trial import DIVERGED

SHOWN = ("score", "success", "objective", "steps", "restarts", "node")


class Ranking(Callback):
    """Ranking of the trials, best first, in a JSON file beside Ray Tune's folder.

    Ray stores this object with the sweep, whose folder may have moved when it is resumed.
    """

    def __init__(self, name: str) -> None:
        self.name = name  # of the file

    def on_trial_result(
        self, iteration: int, trials: list[Any], trial: Any, result: dict[str, Any], **info: Any
    ) -> None:
        """Print one line, and write the ranking."""
        number, score, steps = number_of(trial), result["score"], result["steps"]
        what = DIVERGED if DIVERGED in result else f"score {score:.3f}"
        print(f"trial {number}: {what} after {steps:,} steps", flush=True)
        self.write(trials)

    def on_experiment_end(self, trials: list[Any], **info: Any) -> None:
        """Write the ranking."""
        self.write(trials)

    def on_trial_error(self, iteration: int, trials: list[Any], trial: Any, **info: Any) -> None:
        """Print one line, and write the ranking."""
        print(f"trial {number_of(trial)}: lost for good; see {trial.local_path}", flush=True)
        self.write(trials)

    def write(self, trials: list[Any]) -> None:
        """Write all trials as they stand."""
        rows = [row(trial) for trial in trials]
        rows.sort(key=lambda r: -r.get("objective", -float("inf")))
        folder = Path(trials[0].storage.experiment_fs_path).parent
        write_json(folder / self.name, {"versions": versions()["packages"], "trials": rows})


def number_of(trial: Any) -> int:
    """Number of a trial in the plan."""
    number: int = trial.config["planned"]["number"]
    return number


def row(trial: Any) -> dict[str, Any]:
    """Number, state, keywords and latest results of a trial."""
    experiment, latest = trial.config["planned"]["experiment"], trial.last_result or {}
    state = {"TERMINATED": "done", "ERROR": "lost"}.get(trial.status, "unfinished")
    if DIVERGED in latest:
        state = DIVERGED
    elif state == "done" and latest.get("steps", 0) < experiment["total_steps"]:
        state = "stopped early"
    shown = {name: latest[name] for name in SHOWN if name in latest}
    kwargs = experiment["agent"]["kwargs"]
    return {"trial": number_of(trial), "state": state, "kwargs": kwargs} | shown
