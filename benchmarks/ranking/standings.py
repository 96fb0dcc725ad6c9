"""Tables of docs/leaderboard.md, from docs/results/leaderboard.json and agents/tuned.json.

    python -m benchmarks.ranking.standings

They have the best controller of every kind in each task and track, the tasks in which one kind
leads, what policies gain on their bases, the best policy that twenty minutes of training buy, and
the experiments whose keywords were searched. The command fills the blocks
`<!-- NAME --> ... <!-- /NAME -->` of the page.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from agents.config import load_config
from agents.environments import title
from agents.experiments import shipped_experiments
from agents.leaderboard.bound import AGREED, is_moving
from agents.leaderboard.bound import stored as stored_bounds
from agents.leaderboard.kinds import CLASSICAL, KINDS, LEARNED, ON_MODEL
from agents.leaderboard.output import VERDICTS, Tables, best_of_each, leader, ranked, verdict
from agents.leaderboard.statistics import Figures
from agents.leaderboard.tracks import TRACKS
from agents.tune.learners import place_of
from agents.tuned import tuned
from benchmarks.output import RESULTS, ROOT, argument_parser, fill, table
from benchmarks.training.experiments import stored_seconds

PAGE = ROOT / "docs" / "leaderboard.md"
FAMILIES = ("joint control", "linear-quadratic", "predictive")  # of classical control
COLUMNS = (*FAMILIES, LEARNED, ON_MODEL)
BUDGET = 20.0  # [min] of training on one core


def column(name: str, x: Figures) -> str:
    """Column of a controller: its kind, of a classical one its family."""
    if x["kind"] != CLASSICAL:
        return str(x["kind"])
    if "mpc" in name:
        return "predictive"
    return "linear-quadratic" if name.startswith(("lqr", "lqg")) else "joint control"


def blocks() -> dict[str, str]:
    """Text of every block by its name."""
    stored = json.loads((RESULTS / "leaderboard.json").read_text(encoding="utf-8"))
    tables = {track: standings(stored, track) for track in entered(stored)}
    texts = {"leaders": leaders(stored), "gains": gains(stored), "searched": searched(tuned())}
    return tables | texts | {"bought": bought(stored, trained()), "bounds": bounds(stored)}


def entered(stored: Tables) -> list[str]:
    """Tracks that were ranked."""
    return [track for track in TRACKS if all(track in tracks for tracks in stored.values())]


def standings(stored: Tables, track: str) -> str:
    """Best controller of every kind in each task of a track."""
    rows = []
    for env_id, tracks in stored.items():
        found = ranked(tracks[track])
        best: dict[str, str] = {}
        for name in found:
            best.setdefault(column(name, found[name]), name)
        cells = [cell(best[x], found[best[x]], env_id) if x in best else "" for x in COLUMNS]
        first = COLUMNS.index(next(iter(best)))
        cells[first] = f"**{cells[first]}**"
        rows.append([short(env_id), *cells])
    return table(["task", *COLUMNS], rows)


def cell(name: str, x: Figures, env_id: str) -> str:
    """Controller with its regret, RMS tip error or settling time, and its success if not full."""
    if x["success_rate"] == 0.0:
        return f"{name}: settles none"
    if is_moving(env_id):
        rms = x["tip_error_rms_median"]
        value = "fails" if rms is None else f"{1e3 * rms:.{0 if rms > 0.01 else 1}f} mm"
    elif x["regret_iqm"] is not None:
        value = f"{100.0 * x['regret_iqm']:.0f} %"
    else:
        time = x["settling_median"]
        value = "never" if time is None else f"{time:.2f} s"
    return f"{name}: {value}{missed(x['success_rate'])}"


def missed(success: float) -> str:
    """Share of settled episodes, if any is missed."""
    if success == 1.0:
        return ""
    return f", settles {100.0 * success:.{0 if success < 0.995 else 1}f} %"


def leaders(stored: Tables) -> str:
    """Tasks in which each kind leads, and what learned control gains on classical, by track."""
    lines = []
    for track in entered(stored):
        found = {short(env_id): ranked(tracks[track]) for env_id, tracks in stored.items()}
        best = {task: best_of_each(controllers) for task, controllers in found.items()}
        leads = {
            task: leader({kind: found[task][name] for kind, name in names.items()})
            for task, names in best.items()
        }
        lines.append(f"- `{track}`, kinds that lead: {sorted_by(leads, KINDS)}.")
        for kind in (ON_MODEL, LEARNED):
            gained = {
                task: verdict(found[task][names[kind]], names.get(CLASSICAL))
                for task, names in best.items()
                if kind in names
            }
            lines.append(f"  - best {kind} over best classical: {sorted_by(gained, VERDICTS)}.")
    return "\n".join(lines)


def gains(stored: Tables) -> str:
    """Policies on a base by what they gain on it."""
    found = {
        f"`{name}` in {short(env_id)}, {track}": verdict(x, x["base"])
        for env_id, tracks in stored.items()
        for track, controllers in tracks.items()
        for name, x in controllers.items()
    }
    places = {text: [place for place, x in found.items() if x == text] for text in VERDICTS}
    return "\n".join(
        f"- {text.capitalize()}, {len(x)}: {'; '.join(x) or 'none'}." for text, x in places.items()
    )


def trained() -> dict[str, float]:
    """[min] of one training of every experiment, with that of its warm start.

    The shortest of its seeds, which other work disturbed least; infinite without stored results.
    """
    configs = {name: load_config(path) for name, path in shipped_experiments().items()}
    own = {name: min(stored_seconds(name).values(), default=math.inf) / 60.0 for name in configs}
    return {name: own[name] + own.get(x.agent.warm_start or "", 0.0) for name, x in configs.items()}


def bought(stored: Tables, minutes: Mapping[str, float]) -> str:
    """Best policy without a model that one core trains in twenty minutes, by task and track."""
    found: dict[tuple[str, str], list[tuple[Figures, str]]] = {}
    for name, path in shipped_experiments().items():
        env_id, track, policy = place_of(load_config(path))
        x = stored.get(env_id, {}).get(track, {}).get(policy)
        if x is not None and x["kind"] == LEARNED and minutes[name] <= BUDGET:
            found.setdefault((env_id, track), []).append((x, name))
    rows = []
    for env_id, tracks in stored.items():
        for track in tracks:
            if (env_id, track) not in found:
                continue
            x, name = max(found[env_id, track], key=lambda pair: pair[0]["score_mean"])
            classical = {k: v for k, v in ranked(tracks[track]).items() if v["kind"] == CLASSICAL}
            best = max(classical, key=lambda k: classical[k]["score_mean"])
            rows.append([
                short(env_id), track, f"[{name}](results/{name}.md)", f"{minutes[name]:.1f}",
                f"{x['score_mean']:.3f}", f"{best} {classical[best]['score_mean']:.3f}",
            ])  # fmt: skip
    header = ["task", "track", "experiment", "one training [min]", "mean score", "best classical"]
    return table(header, rows, "lllrrl")


def sorted_by(found: Mapping[str, str | None], words: Sequence[str]) -> str:
    """Tasks by the word that was found for them."""
    return ", ".join(
        f"{word} in {listed([task for task, x in found.items() if x == word])}" for word in words
    )


def listed(tasks: Sequence[str]) -> str:
    """Number of tasks, and which."""
    return f"{len(tasks)} ({', '.join(tasks)})" if tasks else "0"


def searched(stored: Mapping[str, Any]) -> str:
    """Experiments with a search for keywords, and those without."""
    found: dict[bool, list[str]] = {True: [], False: []}
    for name, path in shipped_experiments().items():
        env_id, track, policy = place_of(load_config(path))
        found[policy in stored.get(env_id, {}).get(track, {})].append(f"`{name}`")
    return "\n".join(
        f"- {text}, {len(found[key])}: {', '.join(found[key]) or 'none'}."
        for key, text in ((True, "Searched"), (False, "By hand"))
    )


def bounds(env_ids: Iterable[str]) -> str:
    """Episodes with a bound, and how often its two starts agree, by task."""
    rows = []
    for env_id in env_ids:
        cells = []
        for track in ("state", "laboratory"):
            x = stored_bounds(env_id, track)
            cells += ["", ""] if x is None else [str(len(x.seeds)), f"{x.agreement:.0%}"]
        rows.append([short(env_id), *cells])
    agree = f"starts agree within {100 * AGREED:g} %"
    header = ["task", "`state`: episodes", agree, "`laboratory`: episodes", agree]
    return table(header, rows, "lrrrr")


def short(env_id: str) -> str:
    """Task without its package and version."""
    return title(env_id).removesuffix("-v0")


def main() -> None:
    """Fill the blocks of the page."""
    argument_parser("ranking.standings", __doc__).parse_args()
    fill(PAGE, blocks())


if __name__ == "__main__":
    main()
