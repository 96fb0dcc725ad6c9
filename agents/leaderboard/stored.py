"""Entries of a ranking that is stored, which stay beside those of controllers ranked anew."""

import bz2
import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS
from agents.files import unpacked
from agents.leaderboard.bound import best_of
from agents.leaderboard.kinds import needs
from agents.leaderboard.output import EPISODES, SPECTRA
from agents.leaderboard.replay import OPTIMAL
from agents.leaderboard.shipped import policies_of
from agents.leaderboard.statistics import Entry, Spectrum, figures, rounded
from agents.leaderboard.tracks import takes_part
from agents.metrics import METRICS
from dynamics.types import AnyArray

DECISIONS = (  # a figure that an older ranking does not have is null
    "ms_first_action", "ms_per_action", "ms_per_action_p99", "ms_control_step", "late_share",
)  # fmt: skip
Entries = dict[str, dict[str, dict[str, Entry]]]  # by task, track and controller


def read(folder: Path, seeds: Sequence[int] | None, bounds: Path | None = None) -> Entries:
    """Entries of the episodes with these seeds, or of all; a ValueError if the folder has none.

    Metrics and times of decisions are those that are stored. Statistics are computed again, over
    the bounds that are known now, in the package or in the folder `bounds`.
    """
    found: Entries = {}
    try:
        tables = json.loads((folder / "leaderboard.json").read_text(encoding="utf-8"))
        spectra = json.loads(unpacked(folder / SPECTRA))
        table = episodes(folder)
        wanted = seeds or max((met for met, _ in table.values()), key=len)
        for (env_id, track, name), (met, metrics) in table.items():
            if not (met == [*wanted] or (name == OPTIMAL and set(met) <= {*wanted})):
                raise ValueError(f"{name} met the episodes {met[0]} to {met[-1]}")
            before = tables[env_id][track][name]
            now = figures(
                metrics, best_of(env_id, track, met, bounds),
                privileged=before["privileged"], learned=before["training_seeds"] > 0,
            )  # fmt: skip
            now |= needs(name, env_id, track)
            now |= {key: before.get(key) for key in DECISIONS}
            now["judged_late"] = before.get("judged_late", 0.0)
            own = Entry(now, metrics, _spectrum(spectra[env_id][track][name]), met)
            found.setdefault(env_id, {}).setdefault(track, {})[name] = own
    except (OSError, EOFError, KeyError, TypeError, ValueError) as error:
        of = f" of the episodes {seeds[0]} to {seeds[-1]}" if seeds else ""
        raise ValueError(
            f"{folder}: there is no whole ranking{of} ({type(error).__name__}: {error}); name the "
            "--out of one, beside which --seed and --episodes must be the same."
        ) from None
    return found


def known(entries: Entries) -> Entries:
    """Entries of controllers that there are now, or that are a user's."""
    return {
        env_id: {
            track: {name: x for name, x in found.items() if _is_known(name, env_id, track)}
            for track, found in tracks.items()
        }
        for env_id, tracks in entries.items()
    }


def _is_known(name: str, env_id: str, track: str) -> bool:
    if name in CONTROLLERS:
        return takes_part(name, env_id, track)
    return ":" in name or name == OPTIMAL or name in policies_of(env_id, track)


def episodes(folder: Path) -> dict[tuple[str, str, str], tuple[list[int], dict[str, AnyArray]]]:
    """Seeds and metrics (runs, episodes) by task, track and controller."""
    rows: dict[tuple[str, str, str], list[dict[str, str]]] = {}
    with bz2.open(folder / EPISODES, "rt", newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            rows.setdefault((row["task"], row["track"], row["controller"]), []).append(row)
    return {place: _table(found) for place, found in rows.items()}


def _table(rows: Sequence[Mapping[str, str]]) -> tuple[list[int], dict[str, AnyArray]]:
    """Seeds, and metrics (runs, episodes), of a controller's rows, run by run."""
    runs = len({row["run"] for row in rows})
    seeds = [int(row["seed"]) for row in rows[: len(rows) // runs]]
    metrics = {key: rounded(np.array([float(row[key]) for row in rows])) for key in METRICS}
    return seeds, {key: values.reshape(runs, len(seeds)) for key, values in metrics.items()}


def _spectrum(found: Mapping[str, Any]) -> Spectrum:
    density = np.array([np.nan if x is None else x for x in found["density"]])
    return Spectrum(found["step"] * np.arange(density.size), density, found["share"])
