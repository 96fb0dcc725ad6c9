"""Comparison of controllers on the same episodes, with result files, pictures and a table."""

from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from agents.config import Config
from agents.figures import film, plot_recordings, write_gif
from agents.metrics import (
    Best,
    Recording,
    episode_metrics,
    make_batch,
    print_table,
    record,
    write_results,
)
from agents.policy import Controller
from agents.replay import write_replay
from dynamics.types import AnyArray

UNTRAINED, WARM_START = "untrained policy", "warm start"  # policies of a run before its training


def beginning(config: Config) -> str:
    """Name of the network with which an experiment begins."""
    return WARM_START if config.agent.warm_start else UNTRAINED


def titled(env_id: str, kwargs: Mapping[str, Any]) -> str:
    """An id with the keywords that differ from it, as titles show it."""
    return " ".join([env_id, *(f"{name}={_told(value)}" for name, value in kwargs.items())])


def _told(value: Any) -> str:
    """A keyword's value in words: a table's preset, then its numbers and ranges."""
    if not isinstance(value, Mapping):
        return str(value)
    changes = [
        f"{name} {' to '.join(map(str, x)) if isinstance(x, list | tuple) else x}"
        for name, x in value.items()
        if name != "preset"
    ]
    words = [value["preset"]] if "preset" in value else []
    return " ".join([*words, f"({', '.join(changes)})"] if changes else words)


def compare(
    controllers: Mapping[str, Controller],
    env_id: str,
    kwargs: Mapping[str, Any],
    *,
    episodes: int,
    seed: int,
    folder: Path,
    filmed: int = 2,
    plotted: int = 3,
    best: Best | None = None,
    about: Mapping[str, Any] | None = None,
) -> dict[str, dict[str, AnyArray]]:
    """Evaluate the controllers on the episodes seed, seed + 1, ... and write the results.

    Writes `evaluation.json`, `evaluation.csv`, `trajectories.png` with the first `plotted`
    controllers, and `arm.gif` and `replay.html` with the first `filmed` to the folder. With the
    `best` that is known of these episodes, the printed table has regrets.
    Returns the metrics per controller and episode.
    """
    seeds = list(range(seed, seed + episodes))
    recordings: dict[str, Recording] = {}
    with closing(make_batch(env_id, episodes, kwargs)) as envs:
        for name, controller in controllers.items():
            recordings[name] = record(controller, envs, seeds, name)
        reach = float(envs.unwrapped.reach)
    results = {name: episode_metrics(r) for name, r in recordings.items()}
    header = {"env": env_id, "env_kwargs": dict(kwargs), "reach": reach} | dict(about or {})
    write_results(folder, results, seeds, header)
    what = titled(env_id, kwargs)
    title = f"{what}, {episodes} episodes"
    plot_recordings(folder / "trajectories.png", dict(list(recordings.items())[:plotted]), title)
    chosen = list(controllers.items())[:filmed]
    films = {name: film(env_id, kwargs, controller, seed) for name, controller in chosen}
    write_gif(folder / "arm.gif", films, f"{what}, seed {seed}")
    write_replay(folder / "replay.html", films, f"{what}, seed {seed}")
    print_table(results, best)
    return results
