"""Charts for colour-blind readers, drawn from stored results without measuring."""

import json
import sys
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from agents.files import pack, unpacked
from benchmarks import style
from benchmarks.output import RESULTS
from benchmarks.peers import charts as peer_charts
from benchmarks.work_precision import charts as precision_charts
from dynamics.integrators.table import INTEGRATORS
from tests.benchmarks.conftest import Command
from tests.paths import ROOT

SIZE = 150_000  # [bytes] of a picture of the documentation
WIDTH = 830  # [pixels] of a picture in a README
PICTURES = {  # of each command that draws stored results
    "accuracy.stability": [
        f"stability_{name}" for name in ("methods", "spin", "loop", "shapes", "torques")
    ],
    "speed.cost": ["cost"],
    "accuracy.rigid_arms": ["rigid_arms"],
    "peers": ["peers", "error_against_speed"],
    "work_precision": ["work_precision", "work_precision_S1", "work_precision_six-link"],
}
DEFICIENT = {  # in linear RGB: what people without red or green cones see (Vienot, 1999)
    "protan": [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]],
    "deutan": [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]],
}


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    style.pyplot().close("all")


def stored_file(name: str) -> Path:
    file = RESULTS / f"{name.rpartition('.')[2]}.json"
    packed = file.with_suffix(".json.bz2")
    return packed if packed.exists() else file


def stored(name: str) -> Any:
    file = stored_file(name)
    text = unpacked(file) if file.suffix == ".bz2" else file.read_text(encoding="utf-8")
    return json.loads(text.replace('"diverged"', "Infinity"))


def seen(colour: str, sight: str) -> np.ndarray:
    """(3,) colour in CIELAB as a person with this sight sees it."""
    srgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(DEFICIENT[sight]) @ linear, 0.0, 1.0)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.cbrt(np.array(to_xyz) @ linear / [0.9505, 1.0, 1.089])
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def apart(a: str, b: str, sight: str) -> float:
    """Distance of two colours in CIELAB as seen with this sight."""
    return float(np.linalg.norm(seen(a, sight) - seen(b, sight)))


@pytest.mark.parametrize("sight", DEFICIENT)
def test_colours_stay_apart_for_colour_blind_readers(sight: str) -> None:
    assert all(apart(a, b, sight) > 15.0 for a, b in combinations(style.CYCLE, 2))
    assert apart("#1f77b4", "#9467bd", sight) < 10.0  # matplotlib's own blue and purple
    assert apart(style.STABLE, style.FAILED, sight) > 50.0
    assert apart("#5cb860", "#f0643c", sight) < 25.0  # green and red of a map in RdYlGn
    stable, failed = seen(style.STABLE, sight), seen(style.FAILED, sight)
    assert stable[0] - failed[0] > 15.0  # lightness: also in print without colours


def test_methods_and_engines_differ_in_marker_as_well_as_colour() -> None:
    engines = list(stored("peers")["scenes"]["S1"]["lines"])
    for looks in (
        [style.method(name) for name in (*INTEGRATORS, "dop853")],
        [style.engine(name) for name in engines],
        [style.series(k) for k in range(7)],
    ):
        assert len({look["marker"] for look in looks}) == len(looks)
    colours = [style.method(name)["color"] for name in INTEGRATORS]
    assert len({*colours}) == len(INTEGRATORS)


def test_an_engine_that_nobody_knows_still_has_a_line() -> None:
    assert style.engine("Drake")["color"] not in {v["color"] for v in style.ENGINES.values()}


def test_thinned_points_fall_by_the_ratio_and_end_with_the_best() -> None:
    errors = [1.0, 0.9, 0.5, 0.45, 0.1, 0.09]
    assert style.thinned(errors, errors, 2.0) == [1.0, 0.5, 0.1, 0.09]
    assert style.thinned([], [], 2.0) == []


@pytest.mark.parametrize("name", PICTURES)
def test_stored_results_are_drawn_without_measuring(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, benchmark: Command
) -> None:
    """Also without the peers' engines."""
    results = stored(name)
    if name == "work_precision":  # drawing all scenes takes long
        results["scenes"] = {key: results["scenes"][key] for key in ("S1", "six-link")}
    out = tmp_path / stored_file(name).name
    if out.suffix == ".bz2":
        pack(json.dumps(results), out)
    else:
        out.write_text(json.dumps(results))
    before = out.read_bytes()
    images = [] if name == "accuracy.rigid_arms" else ["--images", str(tmp_path)]
    for engine in ("exudyn", "mujoco"):
        monkeypatch.setitem(sys.modules, engine, None)
    benchmark(name, "--charts", "--out", str(out), *images)
    assert out.read_bytes() == before
    for picture in PICTURES[name]:
        path = tmp_path / f"{picture}.png"
        assert 5_000 < path.stat().st_size < SIZE, picture
        assert 5_000 < (RESULTS / path.name).stat().st_size < SIZE, "committed"


def test_the_overview_shows_the_peers_lines_where_they_were_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: dict[str, set[str]] = {}
    monkeypatch.setattr(
        precision_charts, "save_figure",
        lambda figure, path: drawn.update(
            {path.name + axis.get_title(): set(axis.get_legend_handles_labels()[1])
             for axis in figure.axes}
        ),
    )  # fmt: skip
    results = stored("work_precision")
    precision_charts.draw(results, tmp_path)
    for name, scene in results["scenes"].items():
        labels = drawn["work_precision" + scene["title"]]
        peers = {"Exudyn, cable", "Exudyn, tree", "MuJoCo"}
        assert labels & peers == (peers if name in precision_charts.PEERS else set()), name
        assert {"our cheapest runs", "default"} <= labels


def test_without_the_peers_results_only_our_lines_are_drawn(tmp_path: Path) -> None:
    assert precision_charts.peer_lines(tmp_path / "missing.json") == {}


def test_the_headline_is_readable_at_the_width_of_a_readme(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes: list[float] = []
    panels: list[int] = []

    def measure(figure: Any, path: Path) -> None:
        shrunk = WIDTH / (110.0 * figure.get_figwidth())
        texts = [label for axis in figure.axes for label in axis.get_xticklabels()]
        texts += [axis.title for axis in figure.axes] + list(figure.legends[0].get_texts())
        sizes.extend(110.0 / 72.0 * shrunk * text.get_fontsize() for text in texts)
        panels.append(len(figure.axes))

    monkeypatch.setattr(peer_charts, "save_figure", measure)
    peer_charts.headline(stored("peers"), tmp_path / "headline")
    assert panels == [3]
    assert min(sizes) > 11.0  # pixels


def test_the_start_page_shows_the_headline_near_its_top_with_the_command() -> None:
    lines = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").splitlines()
    (place,) = [k for k, line in enumerate(lines) if "error_against_speed.png" in line]
    assert place < 20
    assert any("python -m benchmarks.peers --charts" in line for line in lines[place : place + 6])
    with Image.open(RESULTS / "error_against_speed.png") as picture:
        assert picture.width > WIDTH


def test_maps_are_drawn_in_the_colours_of_the_house() -> None:
    with Image.open(RESULTS / "stability_spin.png") as picture:
        pixels = np.array(picture.convert("RGB"), int).reshape(-1, 3)
    shares = []
    for colour in (style.STABLE, style.FAILED):
        rgb = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        shares.append(np.mean(np.abs(pixels - rgb).max(axis=1) < 8))
    assert min(shares) > 0.05
