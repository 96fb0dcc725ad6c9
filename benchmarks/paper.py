"""Figures of docs/paper.md, from docs/results and the stored certificates.

    python -m benchmarks.paper

Every figure of the page stands in a block `<!-- NAME --> ... <!-- /NAME -->`, which this command
fills; the text between the blocks has none.
"""

import json
from collections import Counter
from typing import Any

from agents.leaderboard.output import rivals
from benchmarks.output import RESULTS, ROOT, argument_parser, fill, table
from dynamics.load import load_arm
from flexarm_env import registration
from flexarm_env.accuracy.certificates import entries
from flexarm_env.accuracy.motions import KINDS

PAGE = ROOT / "docs" / "paper.md"
SCENES = {"OneLink": "one link", "TwoLink": "two links", "SixLink": "six links, spatial"}
SIZE = "batch of 16384"
BATCH = f"{SIZE}, 1 thread, float64 [steps/s]"


def blocks() -> dict[str, str]:
    """Text of every block by its name."""
    stored = {path.stem: json.loads(path.read_text("utf-8")) for path in RESULTS.glob("*.json")}
    return {
        "summary": summary(stored),
        "speed": speed(stored["speed"]),
        "operations": operations(stored["operations"]),
        "peers": peers(stored["peers"]),
        "validation": validation(stored["validation"]),
        "control": control(stored["leaderboard"]),
        "measured": measured(stored["measured_data"]),
    }


def summary(stored: dict[str, Any]) -> str:
    """Sentences with the figures that matter most."""
    rates = [stored["speed"][scene][BATCH]["median"] for scene in SCENES]
    peak = stored["speed"]["machine"]["peak, one core [GFLOP/s]"]["median"]
    ratios = [entry["steady"] for entry in stored["peers"]["comparisons"]]
    verdicts = _verdicts(stored["validation"])
    steps = sum(counts["steps"] for counts in stored["soak"]["counts"].values())
    wrong = sum(
        count
        for counts in stored["soak"]["counts"].values()
        for name, count in counts.items()
        if name not in ("steps", "time out", "invalid", "diverged")
    )
    return (
        f"On one core with a peak of {peak:.0f} GFLOP/s, a {SIZE} takes {_count(rates[0])}, "
        f"{_count(rates[1])} and {_count(rates[2])} control steps per second for one, two and six "
        f"links. {errors()} At equal error it needs {min(ratios):.0f} to {max(ratios):.0f} times "
        "less processor time than the cheapest runs of other engines. Of "
        f"{verdicts.total()} published numbers "
        f"{verdicts['reproduced']} are reproduced and {verdicts['error in print']} are errors "
        f"in print. In {_count(steps)} random and bang-bang steps {wrong} observations, rewards or "
        "flags were wrong."
    )


def errors() -> str:
    """Sentence on the certificates of the environments as they are by default."""
    kinds = {}
    for scene in SCENES:
        arm, control_dt, _ = registration.SCENES[scene]
        found = entries(load_arm(arm), control_dt)[0]["certificate"]["episodes"]
        kinds[scene] = {k: x for k, x in found["kinds"].items() if not KINDS[k].shaken}
    shares = [x["share"] for scene in ("OneLink", "TwoLink") for x in kinds[scene].values()]
    until = min(x["until"][0] for x in kinds["SixLink"].values() if x["until"][0])
    return (
        "In 95 of 100 whole episodes from rest the tip of one and two links stays within "
        f"{1e3 * max(shares):.2g} thousandths of the reach; that of six links stays within one for "
        f"{until:.2g} s."
    )


def speed(stored: dict[str, Any]) -> str:
    """Steps per second of the environments."""
    rows = [
        (
            words,
            str(stored[scene]["coordinates"]),
            f"{stored[scene]['rhs many lanes [ns]']['median']:.3g}",
            f"{100 * stored[scene]['share of peak, many lanes']['median']:.0f} %",
            f"{stored[scene][BATCH]['median']:.2g}",
        )
        for scene, words in SCENES.items()
    ]
    header = ("arm", "coordinates", "right-hand side [ns]", "share of peak",
              f"steps per second, {SIZE}")  # fmt: skip
    return table(header, rows, "lr")


def operations(stored: dict[str, Any]) -> str:
    """Multiplications and additions of M and h beside the published ones."""
    rows = []
    for published in stored["published"]:
        ours = next(
            case
            for case in stored["cases"]
            if (case["size"], case["arm"]) == (published["size"], "general")
            and (case["formulation"], case["rotation"]) == ("gibbs_appell", "linear")
        )
        theirs, found = published["gibbs_appell"], ours["M and h"]
        rows.append((
            ", ".join(map(str, published["size"])),
            f"{theirs['multiplications']} + {theirs['additions']}",
            f"{found['multiplications']} + {found['additions']}",
        ))  # fmt: skip
    header = ("joints, flexible links, modes of each", "published", "traced and folded")
    return table(header, rows, "lrr")


def peers(stored: dict[str, Any]) -> str:
    """Processor time of peers over ours, at an error."""
    rows = [
        (entry["scene"].split(":")[0], f"{entry['error']:.0e}", entry["beside"],
         f"{entry['ratio']:.0f}", f"{entry['steady']:.0f}")
        for entry in stored["comparisons"]
    ]  # fmt: skip
    header = ("scene", "error at most [reach]", "beside", "of all runs", "without luck")
    return table(header, rows, "lrlrr")


def validation(stored: dict[str, Any]) -> str:
    """Counts of verdicts."""
    counts = _verdicts(stored).most_common()
    return table([name for name, _ in counts], [[str(count) for _, count in counts]], "r")


def control(stored: dict[str, Any]) -> str:
    """Best controller of every kind, of every task of two tracks."""
    return rivals(
        {
            env_id: {track: tracks[track] for track in ("state", "laboratory") if track in tracks}
            for env_id, tracks in stored.items()
        }
    )


def measured(stored: dict[str, Any]) -> str:
    """Sentence about the intervals of fits to logs."""
    clean, friction, plucked = stored["cases"]
    return (
        f"Of {clean['logs']} noisy logs, {100 * clean['held'][0]:.0f} % of the intervals of the "
        f"stiffness and {100 * clean['held'][1]:.0f} % of those of the damping hold the truth, of "
        f"plucks {100 * plucked['held'][0]:.0f} % and {100 * plucked['held'][1]:.0f} %. "
        "With dry friction that the model lacks it is "
        f"{100 * friction['held'][0]:.0f} % and {100 * friction['held'][1]:.0f} %, and the command "
        "says so."
    )


def _count(number: float) -> str:
    return f"{number / 1e6:.2g} million" if number < 1e8 else f"{number / 1e6:.0f} million"


def _verdicts(stored: dict[str, Any]) -> Counter[str]:
    return Counter(row["verdict"] for entry in stored["tables"] for row in entry["rows"])


def main() -> None:
    """Fill the blocks of the page."""
    argument_parser("paper", __doc__).parse_args()
    fill(PAGE, blocks())


if __name__ == "__main__":
    main()
