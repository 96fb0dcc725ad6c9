"""Files of a leaderboard: its figures, spectra and episodes, and the page leaderboard.md."""

import bz2
import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from agents.files import atomic_write
from agents.leaderboard.bound import is_moving
from agents.leaderboard.charts import UNRANKED, Results, pictures
from agents.leaderboard.replay import YARDSTICK
from agents.leaderboard.statistics import Entry, Figures, Spectrum
from agents.leaderboard.tracks import TRACKS
from agents.metrics import METRICS, without_infinities
from agents.sentences import plain

EPISODES = "leaderboard.csv.bz2"
SPECTRA = "leaderboard_spectra.json.bz2"
Tables = Mapping[str, Mapping[str, Mapping[str, Figures]]]  # by task, track and controller


def write(folder: Path, results: Results, seeds: Sequence[int]) -> None:
    """Write the files; each replaces its former version as a whole."""
    tables = each(results, lambda entry: entry.figures)
    spectra = each(results, lambda entry: _spectrum(entry.spectrum))
    with atomic_write(folder / "leaderboard.json") as path:
        path.write_text(_json(tables), encoding="utf-8")
    with atomic_write(folder / SPECTRA) as path:
        path.write_bytes(bz2.compress(_json(spectra).encode("utf-8")))
    with (
        atomic_write(folder / EPISODES) as path,
        bz2.open(path, "wt", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(["task", "track", "controller", "run", "seed", *METRICS])
        writer.writerows(episodes(results))
    with atomic_write(folder / "leaderboard.md") as path:
        path.write_text(page(tables, list(pictures(results)), seeds), encoding="utf-8")


def each(results: Results, of: Callable[[Entry], Figures]) -> dict[str, dict[str, Any]]:
    """Values of a function of entries, by task, track and controller."""
    return {
        env_id: {
            track: {name: of(entry) for name, entry in found.items()}
            for track, found in tracks.items()
        }
        for env_id, tracks in results.items()
    }


def a_line_each(tables: Tables) -> str:
    """JSON text with a line per controller."""

    def table(entries: Mapping[str, str], depth: int) -> str:
        margin = "\n" + depth * " "
        lines = ("," + margin).join(f"{json.dumps(key)}: {text}" for key, text in entries.items())
        return "{" + margin + lines + margin[:-1] + "}"

    texts = {
        env_id: table(
            {
                track: table({name: json.dumps(x) for name, x in found.items()}, 3)
                for track, found in tracks.items()
            },
            2,
        )
        for env_id, tracks in tables.items()
    }
    return table(texts, 1)


def episodes(results: Results) -> Iterator[list[Any]]:
    """Rows of the table of all episodes."""
    for env_id, tracks in results.items():
        for track, found in tracks.items():
            for name, entry in found.items():
                for (run, k), _ in np.ndenumerate(entry.metrics["score"]):
                    values = [float(entry.metrics[key][run, k]) for key in METRICS]
                    yield [env_id, track, name, run, entry.seeds[k], *values]


def page(tables: Tables, files: Sequence[str], seeds: Sequence[int]) -> str:
    """Markdown page of the results, with the pictures of these files."""
    about = (
        f"Test episodes {seeds[0]} to {seeds[-1]}. Score: 0 to 1, the share of the episode that is "
        "left after settling; for Track 1 / (1 + RMS / band). IQM: mean of the middle half, "
        "with a 95 % bootstrap interval over episodes. Regret: settling time over the best known, "
        "less 1. Excess: RMS tip error less the smallest known; infinite where an episode failed. "
        f"Decisions: one environment at a time. {YARDSTICK} plays the torques of the best known "
        "in the episodes that have one; it is told which they are, and is not ranked."
    )
    parts = ["# Leaderboard", about, *(f"![{name.split('.')[0]}]({name})" for name in files)]
    parts += ["## Best and runner-up", leaders(tables)]
    parts += ["## Classical and learned", rivals(tables)]
    for env_id, tracks in tables.items():
        parts.append(f"## {env_id}")
        for track, found in tracks.items():
            lines = [
                f"**{track}**: {TRACKS[track].text}",
                "",
                "| controller | success | score, IQM [95 %] | "
                f"{'excess [mm]' if is_moving(env_id) else 'regret'}, IQM [95 %] | settling [s] | "
                "RMS [mm] | decision, median and 99 % [ms] | of [ms] |",
                "|---|---:|---:|---:|---:|---:|---:|---:|",
            ]
            lines += [row(name, found[name]) for name in order(found)]
            parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def leaders(tables: Tables) -> str:
    """Table of the two best controllers of every task and track, and how sure that is."""
    lines = [
        "Probability that the best scores above the runner-up in an episode; ties count half "
        "[95 %].",
        "",
        "| task | track | best | runner-up | probability |",
        "|---|---|---|---|---:|",
    ]
    for place, found in places(tables):
        for first, second in pairwise(list(found)[:2]):
            lines.append(f"{place} | {first} | {second} | {above(found[first], second)} |")
    return "\n".join(lines)


def rivals(tables: Tables) -> str:
    """Table of the best classical and the best learned controller of every task and track.

    One leads where the intervals of both scores are apart.
    """
    lines = [
        "Scores of the best of either kind, IQM [95 %]; one leads where the intervals are apart. "
        "Above: the probability that the learned one scores higher in an episode; ties count half. "
        "Gain: its score less the classical one's in the same episodes.",
        "",
        "| task | track | best classical | best learned | training seeds | leads | above | gain |",
        "|---|---|---|---|---:|---|---:|---:|",
    ]
    for place, found in places(tables):
        if (pair := best_of_either(found)) is None:
            continue
        one, other = (found[name] for name in pair)
        lines.append(
            f"{place} | {pair[0]} {score(one)} | {pair[1]} {score(other)} | "
            f"{other['training_seeds']} | {leader(one, other)} | {above(other, pair[0])} | "
            f"{gain(other, pair[0])} |"
        )
    return "\n".join(lines)


def best_of_either(found: Mapping[str, Figures]) -> tuple[str, str] | None:
    """Best classical and best learned controller; None unless both kinds take part.

    Controllers are given best first. Those of users, whose names hold a colon, are neither.
    """
    ours = {name: x for name, x in found.items() if ":" not in name}
    learned = next((name for name, x in ours.items() if x["training_seeds"]), None)
    classical = next((name for name, x in ours.items() if not x["training_seeds"]), None)
    return None if learned is None or classical is None else (classical, learned)


def leader(classical: Figures, learned: Figures) -> str:
    """Kind that leads, as the intervals of its score are apart from the other's, or neither."""
    if classical["score_ci"][0] > learned["score_ci"][1]:
        return "classical"
    return "learned" if learned["score_ci"][0] > classical["score_ci"][1] else "neither"


def places(tables: Tables) -> Iterator[tuple[str, dict[str, Figures]]]:
    """Cells of every task and track, and its ranked controllers, best first."""
    for env_id, tracks in tables.items():
        for track, found in tracks.items():
            names = [name for name in order(found) if name not in UNRANKED]
            yield (
                f"| {env_id.removeprefix('FlexArm/')} | {track}",
                {name: found[name] for name in names},
            )


def order(found: Mapping[str, Figures]) -> list[str]:
    """Controllers, best first, and the yardstick behind them."""
    return sorted(found, key=lambda name: (found[name]["privileged"], -found[name]["score_iqm"]))


def row(name: str, x: Figures) -> str:
    """Row of a controller in the table of a task and track."""
    settling = x["settling_median"]
    return (
        f"| {name} | {100.0 * x['success_rate']:.0f} % | {score(x)} | {over_best(x)} | "
        f"{_number(settling, '.2f', 'never')} | "
        f"{_number(1e3 * x['tip_error_rms_median'], '.3g', 'failed')} | "
        f"{x['ms_per_action']:.2g}, {x['ms_per_action_p99']:.2g} | {x['ms_control_step']:g} |"
    )


def score(x: Figures) -> str:
    """Interquartile mean of the score with its interval."""
    low, high = x["score_ci"]
    return f"{x['score_iqm']:.3f} [{low:.3f}, {high:.3f}]"


def above(x: Figures, other: str) -> str:
    """Probability that a controller scores above another in an episode, with its interval."""
    better = x["improvement"][other]
    p, low, high = (100.0 * value for value in (better["p"], *better["ci"]))
    return f"{p:.0f} % [{low:.0f}, {high:.0f}]"


def gain(x: Figures, other: str) -> str:
    """Score less that of another in the same episodes, with its interval."""
    better = x["improvement"][other]
    middle, low, high = (f"{value:+.4f}" for value in (better["gain"], *better["gain_ci"]))
    return f"{middle} [{low}, {high}]"


def over_best(x: Figures) -> str:
    """Excess [mm] on a path, else the regret, with its interval; a dash if no bound is known."""
    if x["excess_iqm"] is not None:
        middle, *ends = (
            _number(round(1e3 * value, 4) + 0.0, ".3g", "failed")
            for value in (x["excess_iqm"], *x["excess_ci"])
        )
        return middle if middle == "failed" else f"{middle} [{', '.join(ends)}]"
    if x["regret_iqm"] is None:
        return "-"
    least, most = x["regret_ci"]
    return f"{100.0 * x['regret_iqm']:.0f} % [{100.0 * least:.0f}, {100.0 * most:.0f}]"


def _spectrum(found: Spectrum) -> Figures:
    """Step of frequency [Hz], density [1/m^2/Hz] to four digits and share of episodes [-]."""
    density = [float(f"{value:.4g}") for value in found.density]
    return {"step": float(found.frequency[1]), "share": found.share, "density": density}


def _json(tables: Tables) -> str:
    return a_line_each(without_infinities(tables)) + "\n"


def _number(x: float, style: str, otherwise: str) -> str:
    return plain(x, style) if np.isfinite(x) else otherwise
