"""Searches by trials: their number, their episodes, their objective, and how they go on.

A search that is kept writes every trial into a journal of Optuna, text in JSON, as it ends. One
that was interrupted goes on from there: it draws what is left of its trials anew.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from agents.files import FolderError
from agents.run_folder.lock import folder_lock
from agents.run_folder.log import repair_log
from dynamics.description import validate
from dynamics.extras import missing
from dynamics.types import AnyArray

TRIALS = 40
MOST = 100_000  # trials of a search
EPISODES = 48
SEED = 500_000  # of the first tuning episode
SLIGHT = 1e-3  # weight of the RMS error, which decides between equal scores
JOURNAL = "trials.log"
ABOUT = "about"  # attribute of a study: what is searched
GIVEN = "given"  # attribute of a trial: its number among the first ones
ENDED = ("COMPLETE", "PRUNED")  # states of trials that ran to their end or were poor


@contextmanager
def kept_study(folder: Path | None, about: Mapping[str, Any]) -> Iterator[Any]:
    """Optuna's study whose trials stand in a folder, or without one in memory.

    `about` says what is searched, in terms that JSON has.

    Raises
    ------
    FolderError : if the folder has another search or a damaged one, or another process uses it.
    """
    try:
        import optuna
        from optuna.storages.journal import JournalFileBackend, JournalStorage
    except ModuleNotFoundError as error:
        raise missing(error, "agents.tune", "train") from None

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    if folder is None:
        yield optuna.create_study(direction="maximize")
        return
    folder.mkdir(parents=True, exist_ok=True)
    with folder_lock(folder):
        journal = (folder / JOURNAL).resolve()
        repair_log(journal)
        journal.with_name(f"{JOURNAL}.lock").unlink(missing_ok=True)  # Optuna's, of a kill
        try:
            storage = JournalStorage(JournalFileBackend(str(journal)))
            study = optuna.create_study(
                storage=storage, study_name="search", direction="maximize", load_if_exists=True
            )
        except (ValueError, KeyError):
            raise FolderError(f"{journal}: is damaged; remove it to search anew.") from None
        text = json.dumps(about, sort_keys=True)
        if study.user_attrs.get(ABOUT, text) != text:
            raise FolderError(f"{folder}: has another search; remove it or choose another folder.")
        study.set_user_attr(ABOUT, text)
        yield study


def searched(
    study: Any,
    judged: Callable[[Any], float],
    trials: int,
    first: Sequence[Mapping[str, float]] = (),
    reduction: int | None = None,
    report: Callable[[int, float | None], None] = lambda count, value: None,
) -> list[Any]:
    """Trials of Optuna's TPE sampler that have ended; the first are those given.

    With a `reduction`, one of so many goes on at each step of successive halving. `report` is told
    how many trials have ended, and the objective of the latest, None if it was ended early.
    """
    from optuna import TrialPruned
    from optuna.pruners import NopPruner, SuccessiveHalvingPruner
    from optuna.samplers import TPESampler
    from optuna.trial import TrialState

    validate.integer(trials, "trials", 1, MOST)
    done = len(finished(study))
    study.sampler = TPESampler(seed=done)  # a search that goes on repeats no draws
    halving = SuccessiveHalvingPruner(min_resource=1, reduction_factor=reduction or 2)
    study.pruner = halving if reduction else NopPruner()
    met = {t.user_attrs.get(GIVEN) for t in study.trials if t.state.name in (*ENDED, "WAITING")}
    for k, parameters in enumerate(first):
        if k not in met:
            study.enqueue_trial(dict(parameters), user_attrs={GIVEN: k})
    for count in range(done + 1, trials + 1):
        trial = study.ask()
        try:
            value = judged(trial)
        except TrialPruned:
            study.tell(trial, state=TrialState.PRUNED)
            report(count, None)
        else:
            study.tell(trial, value)
            report(count, value)
    return finished(study)


def finished(study: Any) -> list[Any]:
    """Trials of a study that have ended, none that was interrupted."""
    return [trial for trial in study.trials if trial.state.name in ENDED]


def objective(metrics: Mapping[str, AnyArray], reach: float) -> float:
    """Mean score, less a thousandth of the mean RMS tip error over the reach, at most 1."""
    apart = np.minimum(metrics["tip_error_rms"] / reach, 1.0)
    return float(metrics["score"].mean()) - SLIGHT * float(apart.mean())
