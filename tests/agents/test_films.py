"""Films of the environment pages."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageSequence

from agents import films
from agents.figures import (
    GIF_HEIGHT,
    Film,
    draw_strips,
    error_band,
    save_gif,
    steps_per_frame,
    write_gif,
)
from agents.metrics import Recording

ID = "FlexArm/OneLink-Reach-v0"
GROUND, DOT = (250, 250, 248), (200, 30, 30)


def test_the_controller_with_the_highest_score_is_filmed() -> None:
    """`optimal`, which knows the episodes, is none of them."""
    scores = {"pd": 0.4, "lqr": 0.8, "optimal": 0.9}
    rows = {k: {"score_iqm": x, "privileged": k == "optimal"} for k, x in scores.items()}
    ranking = {ID: {"state": rows}}
    assert films.best(ranking, ID) == "lqr"
    assert films.best(ranking, "FlexArm/FreeFlyer-Reach-v0") == "pd"


def test_a_film_lasts_as_long_as_its_episode(tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    films.write(path, "zero", ID)
    with Image.open(path) as film:
        frames: Any = film
        assert frames.size == (360, films.HEIGHT)
        assert (frames.n_frames - 1) * frames.info["duration"] == pytest.approx(3000)


@pytest.mark.parametrize("control_dt", [0.0125, 0.02, 0.05])
def test_film_and_cursor_of_a_comparison_end_with_the_episode(
    control_dt: float, tmp_path: Path
) -> None:
    time = control_dt * np.arange(25)
    ones = np.ones((25, 1))
    recording = Recording(
        time=time, tip_error=ones, tip_deflection=ones, root_curvature=ones[..., None],
        torque=ones[..., None], action=ones[..., None], failed=np.array([False]), reach=1.0,
        duration=time[-1], moving=False,
    )  # fmt: skip
    frames = [np.full((GIF_HEIGHT, 400, 3), GROUND, np.uint8)] * (24 // steps_per_frame(control_dt))
    form = np.zeros((25, 1, 2, 3))
    taken = Film([frames[0], *frames], recording, form, form, form[:, 0, 0], planar=True)
    write_gif(tmp_path / "a.gif", {"pd": taken}, "title")
    _, to_pixel = draw_strips({"pd": recording}, 400, "title")
    with Image.open(tmp_path / "a.gif") as gif:
        film: Any = gif
        shown = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
        assert sum(shown[:-1]) == pytest.approx(1000 * time[-1], abs=5.0)  # [ms], half a hundredth
        last: Any = film.convert("RGB").getpixel((to_pixel(time[-1]), film.height - 1))
    assert max(last) < 100


def test_bands_of_the_tip_error_count_episodes_that_have_failed() -> None:
    """Else the few that are left would stand for all."""
    error = np.full((3, 11), 0.1)  # [m]
    error[1:, 0] = error[2:, 1:7] = np.nan  # one fails, then six more
    ones = np.ones((3, 11, 1))
    failing = Recording(
        time=np.arange(3.0), tip_error=error, tip_deflection=error, root_curvature=ones,
        torque=ones, action=ones, failed=np.isnan(error[-1]), reach=1.0, duration=2.0, moving=False,
    )  # fmt: skip
    low, middle, high = np.isfinite(error_band(failing))
    assert low.tolist() == [True, True, True]
    assert middle.tolist() == [True, True, False]
    assert high.tolist() == [True, True, False]


def test_an_unknown_id_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert films.main(["FlexArm/NoLink-Reach-v0", "--out", str(tmp_path / "films")]) == 2
    assert "unknown ids ['FlexArm/NoLink-Reach-v0']" in capsys.readouterr().err
    assert not (tmp_path / "films").exists()


def test_a_folder_that_cannot_be_written_to_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert films.main([ID, "--out", str(tmp_path / "file")]) == 2
    assert "cannot be written to" in capsys.readouterr().err


def test_few_colours_keep_the_ground_and_what_is_rare(tmp_path: Path) -> None:
    """Gradients of hundreds of colours must not take those of ground and dot."""
    image = Image.new("RGB", (200, 200), GROUND)
    for x in range(200):
        image.paste((x, 255, 255 - x), (x, 0, x + 1, 20))
        image.paste((255, 255 - x // 20, 255 - x // 40), (x, 20, x + 1, 40))
    image.paste(DOT, (100, 100, 104, 104))
    save_gif(tmp_path / "a.gif", [image, image.rotate(90)], colours=32)
    with Image.open(tmp_path / "a.gif") as film:
        shown = film.convert("RGB")
    assert shown.getpixel((10, 150)) == GROUND
    dot: Any = shown.getpixel((102, 102))
    assert max(abs(a - b) for a, b in zip(dot, DOT, strict=True)) < 30
