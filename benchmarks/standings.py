"""Tables of docs/leaderboard.md, from docs/results/leaderboard.json and agents/tuned.json.

    python -m benchmarks.standings

They have the best controller of every kind in each task and track, the tasks in which one kind
leads, and the experiments whose keywords were searched. The command fills the blocks
`<!-- NAME --> ... <!-- /NAME -->` of the page.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from agents.config import load_config
from agents.controllers import CONTROLLERS
from agents.experiments import shipped_experiments
from agents.leaderboard.bound import is_moving
from agents.leaderboard.charts import UNRANKED
from agents.leaderboard.output import best_of_either, leader, order
from agents.leaderboard.shipped import LINKS
from agents.leaderboard.statistics import Figures
from agents.leaderboard.tracks import TRACKS
from agents.learners.algorithms import DISTILLED
from agents.tune.learners import place_of
from agents.tuned import tuned
from benchmarks.output import RESULTS, ROOT, argument_parser, filled, table

PAGE = ROOT / "docs" / "leaderboard.md"
KINDS = ("joint control", "linear-quadratic", "predictive", "learned", "learned, on a model")
Tables = Mapping[str, Mapping[str, Mapping[str, Figures]]]  # by task, track and controller


def kind(name: str) -> str:
    """Kind of a controller of the package."""
    if name not in CONTROLLERS:
        based = any(f"-{link}-" in name for key, link in LINKS.items() if key != DISTILLED)
        return "learned, on a model" if based else "learned"
    if "mpc" in name:
        return "predictive"
    return "linear-quadratic" if name.startswith(("lqr", "lqg")) else "joint control"


def blocks() -> dict[str, str]:
    """Text of every block by its name."""
    stored = json.loads((RESULTS / "leaderboard.json").read_text(encoding="utf-8"))
    tables = {track: standings(stored, track) for track in TRACKS}
    return tables | {"leaders": leaders(stored), "searched": searched(tuned())}


def standings(stored: Tables, track: str) -> str:
    """Best controller of every kind in each task of a track."""
    rows = []
    for env_id, tracks in stored.items():
        found = ranked(tracks[track])
        best: dict[str, str] = {}
        for name in found:
            best.setdefault(kind(name), name)
        cells = [cell(best[x], found[best[x]], env_id) if x in best else "" for x in KINDS]
        first = KINDS.index(kind(next(iter(found))))
        cells[first] = f"**{cells[first]}**"
        rows.append([short(env_id), *cells])
    return table(["task", *KINDS], rows)


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
    """Tasks in which one kind leads, and in which it gains on the other, track by track."""
    lines = []
    for track in TRACKS:
        leads: dict[str, list[str]] = {"classical": [], "learned": [], "neither": []}
        gains: dict[str, list[str]] = {"classical": [], "learned": [], "neither": []}
        for env_id, tracks in stored.items():
            here = ranked(tracks[track])
            if (pair := best_of_either(here)) is not None:
                classical, learned = (here[name] for name in pair)
                leads[leader(classical, learned)].append(short(env_id))
                gains[gaining(learned, pair[0])].append(short(env_id))
        count = sum(map(len, leads.values()))
        lines.append(
            f"- `{track}`, {count} tasks: classical control leads in {listed(leads['classical'])}, "
            f"learned control in {listed(leads['learned'])}. In the same episodes classical "
            f"control is ahead in {listed(gains['classical'])}, learned control in "
            f"{listed(gains['learned'])}."
        )
    return "\n".join(lines)


def gaining(learned: Figures, classical: str) -> str:
    """Kind whose score is above the other's in the same episodes, by the interval, or neither."""
    low, high = learned["improvement"][classical]["gain_ci"]
    return "learned" if low > 0.0 else "classical" if high < 0.0 else "neither"


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


def ranked(found: Mapping[str, Figures]) -> dict[str, Figures]:
    """Ranked controllers, best first."""
    return {name: found[name] for name in order(found) if name not in UNRANKED}


def short(env_id: str) -> str:
    """Task without its package and version."""
    return env_id.removeprefix("FlexArm/").removesuffix("-v0")


def main() -> None:
    """Fill the blocks of the page."""
    argument_parser("standings", __doc__).parse_args()
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), blocks()), encoding="utf-8")


if __name__ == "__main__":
    main()
