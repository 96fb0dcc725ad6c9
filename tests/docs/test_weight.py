"""The documentation in the repository stays light, and so does what its writers write."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from agents.figures import (
    LARGEST_PICTURE,
    few_colours,
    film_palette,
    new_figure,
    save_figure,
    save_gif,
)
from tests.paths import ROOT

DOCS = ROOT / "docs"
WHOLE = 14e6  # [bytes] of the folder docs
LIMITS = {".png": 150_000, ".gif": 300_000}  # [bytes] of a file


def test_the_documentation_is_light() -> None:
    assert sum(path.stat().st_size for path in DOCS.rglob("*") if path.is_file()) < WHOLE


@pytest.mark.parametrize("suffix", LIMITS)
def test_pictures_and_films_are_small(suffix: str) -> None:
    sizes = {path.name: path.stat().st_size for path in DOCS.rglob(f"*{suffix}")}
    assert {name: size for name, size in sizes.items() if size >= LIMITS[suffix]} == {}


def test_every_picture_has_a_palette() -> None:
    """As `save_figure` writes it."""
    modes = {path.name: Image.open(path).mode for path in DOCS.rglob("*.png")}
    assert {name: mode for name, mode in modes.items() if mode != "P"} == {}


def test_a_figure_of_many_colours_gets_fewer_pixels_until_it_is_small(tmp_path: Path) -> None:
    figure = new_figure(5.0, 4.0)
    noise = np.random.default_rng(0).uniform(size=(300, 400, 3))
    figure.subplots().imshow(noise, aspect="auto")
    save_figure(figure, tmp_path / "noise.png")
    with Image.open(tmp_path / "noise.png") as picture:
        assert picture.mode == "P"
        assert picture.width < 5.0 * figure.dpi
    assert (tmp_path / "noise.png").stat().st_size <= LARGEST_PICTURE < LIMITS[".png"]


def test_a_rare_line_keeps_its_colour(tmp_path: Path) -> None:
    figure = new_figure(4.0, 3.0)
    axes = figure.subplots()
    axes.plot([0.0, 1.0], [0.0, 1.0], color="#0072b2", linewidth=4.0)
    axes.plot([0.0, 0.1], [0.5, 0.5], color="#e69f00", linewidth=4.0)
    save_figure(figure, tmp_path / "lines.png")
    with Image.open(tmp_path / "lines.png") as picture:
        colours = {colour for _, colour in picture.convert("RGB").getcolors() or ()}
    assert {(0x00, 0x72, 0xB2), (0xE6, 0x9F, 0x00), (255, 255, 255)} <= colours


def test_frequent_colours_stay_exactly_as_they_are() -> None:
    """White stays white beside the pale greys of a grid and of smooth text."""
    greys = np.arange(225, 256, dtype=np.uint8)
    picture = np.repeat(np.repeat(greys, 40)[None, :, None], 30, axis=0).repeat(3, axis=2)
    found = few_colours(Image.fromarray(picture))
    np.testing.assert_array_equal(np.asarray(found.convert("RGB")), picture)


def test_a_small_marker_keeps_its_colour_beside_the_greys_of_letters() -> None:
    greys = np.arange(100, 200, dtype=np.uint8).repeat(400).reshape(200, 200)
    picture = np.repeat(greys[..., None], 3, axis=2)
    marker = (0x56, 0xB4, 0xE9)
    picture[:10, :10] = marker
    found = few_colours(Image.fromarray(picture)).convert("RGB")
    assert np.all(np.asarray(found)[:10, :10] == marker)


def test_a_film_is_the_same_and_holds_changes_alone(tmp_path: Path) -> None:
    """Every frame as its pictures show it, though most of it is not written again."""
    rng = np.random.default_rng(0)
    ground = rng.integers(0, 4, (100, 200), np.uint8)[..., None] * np.uint8([60, 40, 20])
    frames = []
    for k in range(20):
        frames.append(ground.copy())
        frames[-1][10:20, 5 * k : 5 * k + 10] = (0, 0, 0)
    images = [Image.fromarray(frame) for frame in frames]
    save_gif(tmp_path / "all.gif", images, colours=32)
    save_gif(tmp_path / "one.gif", images[:1], colours=32)
    with Image.open(tmp_path / "all.gif") as film:
        assert film.n_frames == len(frames)
        for k, frame in enumerate(frames):
            film.seek(k)
            assert np.abs(np.asarray(film.convert("RGB"), int) - frame).max() < 3, k
    small, whole = ((tmp_path / name).stat().st_size for name in ("one.gif", "all.gif"))
    assert whole < 3 * small
    assert len(film_palette(images, 31).getpalette() or ()) == 3 * 256
