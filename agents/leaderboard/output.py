"""Files of a leaderboard: its figures, spectra and episodes, and the page leaderboard.md."""

import bz2
import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from agents.environments import title
from agents.files import atomic_write, pack, shortened, without_infinities
from agents.leaderboard.bound import is_moving
from agents.leaderboard.charts import UNRANKED, Results, pictures
from agents.leaderboard.kinds import CLASSICAL, KINDS, LEARNED, ON_MODEL
from agents.leaderboard.replay import OPTIMAL
from agents.leaderboard.statistics import DIGITS, Entry, Figures, Spectrum
from agents.leaderboard.tracks import TRACKS
from agents.metrics import METRICS
from agents.sentences import plain
from flexarm_env.accuracy.table import table

EPISODES = "leaderboard.csv.bz2"
SPECTRA = "leaderboard_spectra.json.bz2"
GAIN, NO_GAIN, LOSS = VERDICTS = ("gain", "no gain", "loss")  # to another, by the interval
REDRAWN = "Made from the stored episodes by `python -m agents.leaderboard --redraw --out FOLDER`."
Tables = Mapping[str, Mapping[str, Mapping[str, Figures]]]  # by task, track and controller


def write(folder: Path, results: Results, seeds: Sequence[int]) -> None:
    """Write the files; each replaces its former version as a whole."""
    tables = each(results, lambda entry: entry.figures)
    spectra = each(results, lambda entry: _spectrum(entry.spectrum))
    with atomic_write(folder / "leaderboard.json") as path:
        path.write_text(_json(tables), encoding="utf-8")
    with atomic_write(folder / SPECTRA) as path:
        pack(_json(spectra), path)
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

    def braced(entries: Mapping[str, str], depth: int) -> str:
        margin = "\n" + depth * " "
        lines = ("," + margin).join(f"{json.dumps(key)}: {text}" for key, text in entries.items())
        return "{" + margin + lines + margin[:-1] + "}"

    texts = {
        env_id: braced(
            {
                track: braced({name: _compact(x) for name, x in found.items()}, 3)
                for track, found in tracks.items()
            },
            2,
        )
        for env_id, tracks in tables.items()
    }
    return braced(texts, 1)


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
        "left after settling; for Track 1 / (1 + RMS / band). IQM: mean of the middle half. "
        "Intervals are 95 % bootstrap intervals over training seeds and episodes; where a "
        "controller has no training seeds, or one, they cover the choice of the episodes alone. "
        "Regret: settling time over the best known, less 1. Excess: RMS tip error less the "
        "smallest known; infinite where an episode failed. Kind: learned-on-model needs a model of "
        "the arm while it acts. Gain on its base: IQM less that of the controller on which a "
        "policy acts, in the same episodes; no gain where the interval includes zero. Decisions: "
        "one environment at a time. Late: share of decisions that take longer than the control "
        "step, and, above 1 %, the delay in control steps with which the episodes are judged; at "
        "most, or at least, 1 % as the 99 % time tells where no share is stored. A dash: "
        f"not known. {OPTIMAL} plays the torques of the best known in the episodes that have "
        "one; it is told which they are, and is not ranked."
    )
    parts = ["# Leaderboard", REDRAWN, about]
    parts += [f"![{name.split('.')[0]}]({name})" for name in files]
    parts += ["## Best and runner-up", leaders(tables)]
    parts += ["## Kinds", rivals(tables)]
    for env_id, tracks in tables.items():
        parts.append(f"## {env_id}")
        for track, found in tracks.items():
            best = "excess [mm]" if is_moving(env_id) else "regret"
            (step,) = {x["ms_control_step"] for x in found.values()}
            header = (
                "controller", "kind", "training seeds", "success", "score, mean",
                "score, IQM [95 %]", f"{best}, IQM [95 %]", "gain on its base [95 %]",
                "settling [s]", "RMS [mm]", "decision: first, median, 99 % [ms]", "late",
            )  # fmt: skip
            parts.append(f"**{track}**: {TRACKS[track].text}; control step {step:g} ms")
            parts.append(table(header, [row(name, found[name]) for name in order(found)], "llr"))
    return "\n\n".join(parts) + "\n"


def leaders(tables: Tables) -> str:
    """Table of the two best controllers of every task and track, and how sure that is."""
    rows = []
    for place, found in places(tables):
        for first, second in pairwise(list(found)[:2]):
            x = found[first]
            cells = above(x, second), gain(x, second), f"{x['score_mean_moves']:.3f}"
            rows.append([*place, first, second, *cells])
    header = ("task", "track", "best", "runner-up", "probability", "gain", "mean moves by")
    return (
        "Probability that the best scores above the runner-up in an episode; ties count half "
        "[95 %]. Gain: its score less that of the runner-up in the same episodes [95 %]. Between "
        "two sets of so many episodes the best's mean score moves by so much (standard "
        "deviation).\n\n" + table(header, rows, "llllr")
    )


def rivals(tables: Tables) -> str:
    """Table of the best controller of every kind, in every task and track."""
    rows = []
    for place, found in places(tables):
        best = best_of_each(found)
        cells = [
            f"{best[kind]} {score(found[best[kind]])}" if kind in best else "-" for kind in KINDS
        ]
        cells.append(leader({kind: found[name] for kind, name in best.items()}))
        for kind in (ON_MODEL, LEARNED):
            pair = CLASSICAL in best and kind in best
            cells.append(gain(found[best[kind]], best[CLASSICAL]) if pair else "-")
        rows.append([*place, *cells])
    header = ("task", "track", *KINDS, "leads", f"gain, {ON_MODEL}", f"gain, {LEARNED}")
    return (
        "Scores of the best of every kind, IQM [95 %]; one leads where its interval is above those "
        "of the others. Gain: the score less that of the best classical one in the same episodes."
        "\n\n" + table(header, rows, "llllllr")
    )


def best_of_each(found: Mapping[str, Figures]) -> dict[str, str]:
    """Best controller of every kind, of controllers that are given best first.

    Those of users are of no kind.
    """
    best: dict[str, str] = {}
    for name, x in found.items():
        if x["kind"] is not None:
            best.setdefault(x["kind"], name)
    return best


def leader(best: Mapping[str, Figures]) -> str:
    """Kind whose interval of the score is above those of all others, or none; a dash if alone."""
    if len(best) < 2:
        return "-"
    for kind, x in best.items():
        others = [y for other, y in best.items() if other != kind]
        if all(x["score_ci"][0] > y["score_ci"][1] for y in others):
            return kind
    return "none"


def places(tables: Tables) -> Iterator[tuple[tuple[str, str], dict[str, Figures]]]:
    """Every task and track, and its ranked controllers, best first."""
    for env_id, tracks in tables.items():
        for track, found in tracks.items():
            yield (title(env_id), track), ranked(found)


def ranked(found: Mapping[str, Figures]) -> dict[str, Figures]:
    """Ranked controllers, best first."""
    return {name: found[name] for name in order(found) if name not in UNRANKED}


def order(found: Mapping[str, Figures]) -> list[str]:
    """Controllers, best first, and `optimal` behind them."""
    return sorted(found, key=lambda name: (found[name]["privileged"], -found[name]["score_iqm"]))


def row(name: str, x: Figures) -> list[str]:
    """Cells of a controller in the table of a task and track."""
    times = (x["ms_first_action"], x["ms_per_action"], x["ms_per_action_p99"])
    return [
        name,
        x["kind"] or "-",
        str(x["training_seeds"] or "-"),
        f"{100.0 * x['success_rate']:.0f} %",
        f"{x['score_mean']:.3f}",
        score(x),
        over_best(x),
        on_base(x),
        _number(x["settling_median"], ".2f", "never"),
        _number(1e3 * x["tip_error_rms_median"], ".3g", "failed"),
        ", ".join("-" if time is None else f"{time:.2g}" for time in times),
        late(x),
    ]


def on_base(x: Figures) -> str:
    """Gain of a policy on the controller on which it acts, where both are ranked."""
    found = verdict(x, x["base"])
    return "-" if found is None else gain(x, x["base"]) + ", no gain" * (found == NO_GAIN)


def verdict(x: Figures, other: str | None) -> str | None:
    """GAIN, NO_GAIN or LOSS to another in the same episodes, by the interval; None without it."""
    if other not in x.get("improvement", ()):  # which come when all are ranked
        return None
    low, high = x["improvement"][other]["gain_ci"]
    return GAIN if low > 0.0 else LOSS if high < 0.0 else NO_GAIN


def late(x: Figures) -> str:
    """Share of decisions later than the control step, or on which side of 1 % it is; the delay."""
    if x["late_share"] is not None:
        delay = f", {x['judged_late']:.2g} steps" if x["judged_late"] else ""
        return f"{100.0 * x['late_share']:.1f} %{delay}"
    return "≥ 1 %" if x["ms_per_action_p99"] > x["ms_control_step"] else "≤ 1 %"


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
    middle, least, most = (round(100.0 * value) for value in (x["regret_iqm"], *x["regret_ci"]))
    return f"{middle} % [{least}, {most}]"


def _spectrum(found: Spectrum) -> Figures:
    """Step of frequency [Hz], density [1/m^2/Hz] to four digits and share of episodes [-]."""
    density = [float(f"{value:.4g}") for value in found.density]
    return {"step": float(found.frequency[1]), "share": found.share, "density": density}


def _json(tables: Tables) -> str:
    return a_line_each(without_infinities(tables)) + "\n"


def _compact(x: Any) -> str:
    """JSON text of figures, whose floats have the digits of the episodes."""
    return json.dumps(shortened(x, DIGITS), separators=(",", ":"))


def _number(x: float, style: str, otherwise: str) -> str:
    return plain(x, style) if np.isfinite(x) else otherwise
