"""Torques of the best controllers, for certificates: `python -m agents.leaderboard.recorded`.

For every registered scene with a ranking on exact states this plays episodes that the ranking does
not have, under its best classical and its best learned controller, and stores starts and actions in
flexarm_env/certify/recorded, where `flexarm certify` finds them. Actions are rounded to 1/127.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.leaderboard.run import built
from agents.leaderboard.tracks import keywords
from agents.metrics import make_batch, record
from dynamics.command import completed
from dynamics.description.data_file import user_path
from dynamics.types import AnyArray
from flexarm_env.accuracy.motions import AGILE, LEVELS, RECORDED
from flexarm_env.certify.certificate import EPISODES

RANKING = Path("docs/results/leaderboard.json")
TRACK = "state"
SEED = 40_000  # first of the episodes


def recorded(env_id: str, name: str) -> dict[str, AnyArray]:
    """Start angles (N, n_joint) [rad] and actions (T, N, n_joint) of a ranked controller."""
    given = keywords(name, TRACK)
    design = make_batch(env_id, 1, given)
    envs = make_batch(env_id, EPISODES, given)
    seeds = list(range(SEED, SEED + EPISODES))
    subject = next(built(name, design, env_id, TRACK))
    envs.reset(seed=seeds)
    core = envs.unwrapped.core
    start = core.q[:, list(core.arm.joint_index)].copy()
    actions = np.nan_to_num(record(subject, envs, seeds).action[1:])
    return {"start": start, "actions": np.rint(LEVELS * actions).astype(np.int8)}


def best(figures: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Best controller of either kind, by the score; none is told what it meets."""
    ranked = sorted(figures, key=lambda name: -figures[name]["score_iqm"])
    result: dict[str, str] = {}
    for name in ranked:
        if not figures[name]["privileged"]:
            kind = "learned" if figures[name]["training_seeds"] else "classical"
            result.setdefault(kind, name)
    return result


def write(folder: Path, env_id: str, names: Mapping[str, str]) -> Path:
    """Record controllers of an id by kind; the file."""
    core: Any = make_batch(env_id, 1, {}).unwrapped.core
    values: dict[str, AnyArray] = {"torque_limit": core.torque_limit}
    for kind, name in names.items():
        found = recorded(env_id, name)
        values |= {f"{kind}_{key}": array for key, array in found.items()}
        values[f"{kind}_name"] = np.array(name)
    path = folder / f"{core.arm.name}{AGILE * env_id.endswith('Agile-v0')}.npz"
    np.savez_compressed(path, **values)  # type: ignore[arg-type]
    return path


def main() -> int:
    """Write the recordings; the exit status."""
    parser = argparse.ArgumentParser(description="Record the torques of the best controllers.")
    parser.add_argument("--out", type=user_path, default=RECORDED, metavar="FOLDER")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    ranking = json.loads(RANKING.read_text(encoding="utf-8"))
    for env_id, tracks in ranking.items():
        if "-Reach" in env_id:
            names = best(tracks[TRACK])
            path = write(folder, env_id, names)
            print(f"{env_id}: {' and '.join(names.values())} in {path}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(completed("agents.leaderboard.recorded", main))
