"""Films of the best ranked controllers: `python -m agents.films --out docs/envs/films`.

One GIF per id, of one episode on exact states. The controller is the best of the track `state` in
docs/results/leaderboard.json, and joint PD with the best gains of its grid where none is ranked.
Ids with goals, events or a cost have the film of the id without.
"""

import argparse
import json
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

from agents.controllers import CONTROLLERS
from agents.evaluate import classical
from agents.figures import film, save_gif
from agents.files import FolderError, check_folder
from agents.hybrid.controller import acting
from agents.leaderboard.shipped import shipped
from agents.leaderboard.tracks import keywords
from agents.metrics import make_batch
from agents.policy import Controller
from agents.sentences import refused
from dynamics.command import completed
from dynamics.description.data_file import user_path
from flexarm_env import IDS
from flexarm_env.pages.environments import film_name, filmed

RANKING = Path(__file__).resolve().parents[1] / "docs" / "results" / "leaderboard.json"
TRACK = "state"
SEED = 10_000  # first test episode of the leaderboard
MOST_FRAMES = 120
HEIGHT = 270  # [px]
COLOURS = 64  # few, so that a film is small
FILMED = tuple(env_id for env_id in IDS if filmed(env_id) == env_id)


def best(ranking: dict[str, Any], env_id: str) -> str:
    """Name of the controller with the highest score; "pd" where the id is not ranked."""
    found = ranking.get(env_id, {}).get(TRACK, {})
    rows = {name: row for name, row in found.items() if not row["privileged"]}
    return max(rows, key=lambda name: rows[name]["score_iqm"], default="pd")


def named(name: str, env_id: str) -> Controller:
    """A controller of the table, or the shipped policy of that name with the first seed."""
    with closing(make_batch(env_id, 1, keywords(name, TRACK))) as env:
        if name in CONTROLLERS:
            return classical(name, env, env_id, keywords(name, TRACK))
        return acting(shipped(env_id, TRACK)[name][0], env)


def write(path: Path, name: str, env_id: str) -> None:
    """Film one episode of a named controller, its name in the picture."""
    taken = film(env_id, keywords(name, TRACK), named(name, env_id), SEED, HEIGHT)
    every = -(-len(taken.frames) // MOST_FRAMES)
    font = ImageFont.load_default(size=15)
    pictures: list[Image.Image] = []
    for frame in taken.frames[::every]:
        picture = Image.fromarray(frame)
        ImageDraw.Draw(picture).text((10, 8), name, fill="#263238", font=font)
        pictures.append(picture)
    save_gif(path, pictures, taken.frame_time * every, COLOURS)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.films", description=__doc__)
    parser.add_argument("ids", nargs="*", metavar="ID", help="default: all")
    parser.add_argument("--out", type=user_path, default=Path("docs/envs/films"), metavar="DIR")
    a = parser.parse_args(arguments)
    unknown = sorted(set(a.ids) - set(FILMED))
    if unknown:
        return refused(parser.prog, f"unknown ids {unknown}; known: {sorted(FILMED)}.")
    if not RANKING.is_file():
        return refused(parser.prog, f"{RANKING} is missing; run from the repository.")
    try:
        check_folder(a.out)
    except FolderError as error:
        return refused(parser.prog, error)
    ranking = json.loads(RANKING.read_text(encoding="utf-8"))
    a.out.mkdir(parents=True, exist_ok=True)
    for env_id in a.ids or FILMED:
        path, name = a.out / film_name(env_id), best(ranking, env_id)
        write(path, name, env_id)
        print(f"{path}: {name}, {path.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(completed("agents.films", main))
