"""Replays: one HTML file with recorded episodes, which a browser shows without a network."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from agents.figures import COLOURS, Film, bending
from agents.files import atomic_write, without_infinities
from dynamics.types import AnyArray
from flexarm_env.task.tasks import SETTLED_BAND

TEMPLATE = Path(__file__).with_name("page.html")
PLACE = "{}/*DATA*/"  # in the template
FINENESS = 20_000  # units of a stored coordinate per reach


def write_replay(path: Path, films: Mapping[str, Film], title: str) -> None:
    """Write the replay of films, in which the user turns, exaggerates and scrubs the motion."""
    text = json.dumps(without_infinities(replay(films, title)), separators=(",", ":"))
    page = TEMPLATE.read_text(encoding="utf-8").replace(PLACE, text.replace("<", "\\u003c"))
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def replay(films: Mapping[str, Film], title: str) -> dict[str, Any]:
    """Data of the page: of every film, forms in whole units, and signals per control step."""
    first = next(iter(films.values()))
    reach, dt = first.recording.reach, float(first.recording.time[1])
    return {
        "title": title,
        "dt": dt,
        "unit": reach / FINENESS,
        "reach": reach,
        "band": 100.0 * SETTLED_BAND,
        "planar": first.planar,
        "films": [
            {
                "name": name,
                "colour": COLOURS[k % len(COLOURS)],
                "bent": _whole(film.bent, reach),
                "straight": _whole(film.straight, reach),
                "target": _whole(film.target, reach),
                "error": _rounded(100.0 * film.recording.tip_error[:, 0] / reach),
                "deflection": _rounded(1e3 * film.recording.tip_deflection[:, 0]),
                "curvature": _rounded(bending(film.recording)),
                "spectrum": spectrum(film, dt),
            }
            for k, (name, film) in enumerate(films.items())
        ],
    }


def spectrum(film: Film, dt: float) -> list[list[float]]:
    """Frequencies [Hz] and amplitudes [1/m] of `bending`, with a Hann window."""
    values = bending(film.recording)
    frequency, power = signal.periodogram(values, 1.0 / dt, "hann", scaling="spectrum")
    return [_rounded(frequency[1:]), _rounded(np.sqrt(2.0 * power[1:]))]


def _whole(points: AnyArray, reach: float) -> list[list[int]]:
    """Rows of flat coordinates in units of reach / FINENESS, one row per control step."""
    rows: list[list[int]] = (
        np.rint(points.reshape(len(points), -1) * FINENESS / reach).astype(int).tolist()
    )
    return rows


def _rounded(values: AnyArray) -> list[float]:
    return [float(f"{value:.4g}") for value in values]
