"""Replays: data as recorded, and a page that needs no network and runs no text as code."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from agents.controllers import joint_pd
from agents.figures import Film, bending, film
from agents.metrics import make_batch
from agents.replay import TEMPLATE, replay, spectrum, write_replay

KWARGS = {"max_episode_steps": 30}
NODE = shutil.which("node")
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module", params=["OneLink", "SixLink"])
def recorded(request: pytest.FixtureRequest) -> Film:
    env_id = f"FlexArm/{request.param}-Reach-v0"
    return film(env_id, KWARGS, joint_pd(make_batch(env_id, 1, KWARGS), 1.0, 0.7), 3)


def data_of(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert found is not None
    result: dict[str, Any] = json.loads(found.group(1))
    return result


def test_the_stored_tip_and_target_give_the_stored_tip_error(recorded: Film) -> None:
    """Two paths: the drawn centre lines, and the info of the environment."""
    data = replay({"pd": recorded}, "title")
    (stored,) = data["films"]
    tip = data["unit"] * np.array(stored["bent"])[:, -3:]
    target = data["unit"] * np.array(stored["target"])
    error = 100.0 * np.linalg.norm(tip - target, axis=1) / data["reach"]
    assert_allclose(error, stored["error"], atol=0.02)  # of rounding to reach / 20 000
    assert len(stored["bent"]) == len(stored["straight"]) == 31


def test_the_rigid_arm_is_straight_and_begins_where_the_bent_one_does(recorded: Film) -> None:
    start, end = recorded.straight[:, :, 0], recorded.straight[:, :, 1]
    lengths = np.linalg.norm(end - start, axis=-1)
    assert_allclose(lengths, lengths[:1].repeat(len(lengths), axis=0), rtol=1e-9)
    assert_allclose(recorded.bent[:, 0, 0], start[:, 0], atol=1e-12)
    assert np.abs(recorded.bent[:, -1, -1] - end[:, -1]).max() > 1e-5


def test_a_spectrum_has_the_amplitude_of_a_sine() -> None:
    n, dt = 200, 0.02
    t = dt * np.arange(n)

    class Sine:
        recording = type(
            "R", (), {"root_curvature": 0.3 * np.sin(2 * np.pi * 5.0 * t)[:, None, None]}
        )

    sine: Any = Sine()
    assert bending(sine.recording).shape == (n,)
    frequency, amplitude = spectrum(sine, dt)
    assert frequency[int(np.argmax(amplitude))] == pytest.approx(5.0)
    assert max(amplitude) == pytest.approx(0.3, rel=1e-3)


def test_the_page_holds_the_data_and_loads_nothing(recorded: Film, tmp_path: Path) -> None:
    name = "</script><script>alert(1)</script><!--"
    write_replay(tmp_path / "replay.html", {name: recorded}, "FlexArm & <title>")
    page = (tmp_path / "replay.html").read_text(encoding="utf-8")
    assert data_of(page)["films"][0]["name"] == name
    assert data_of(page)["title"] == "FlexArm & <title>"
    assert page.count("<script") == TEMPLATE.read_text(encoding="utf-8").count("<script") == 2
    assert not re.search(r"(src|href)\s*=|https?:|@import|fetch\(|innerHTML", page)
    assert len(page) < 120_000


def printed(name: str, before: str, after: str) -> Any:
    """Output of a program in JavaScript with a function of the page between two texts."""
    page = TEMPLATE.read_text(encoding="utf-8")
    function = re.search(rf"^function {name}\(.*?^}}", page, re.S | re.M)
    assert function is not None
    program = f"{before}\n{function.group()}\nconsole.log(JSON.stringify({after}))"
    ran = subprocess.run([str(NODE), "-e", program], capture_output=True, text=True, check=True)
    return json.loads(ran.stdout)


@pytest.mark.skipif(NODE is None, reason="needs node")
def test_an_axis_has_a_mark_at_zero() -> None:
    """Sums of -0.6 and steps of 0.2 pass it at -6e-17."""
    assert printed("ticks", "", "ticks(-0.66, 0.09, 4)") == [-0.6, -0.4, -0.2, 0.0]


@pytest.mark.skipif(NODE is None, reason="needs node")
@pytest.mark.parametrize("speed", [1.0, 0.25])
def test_a_replay_plays_at_its_speed(speed: float) -> None:
    """Three seconds at 60 pictures per second, of a motion of ten seconds."""
    before = f"""
    const data = {{ dt: 0.02 }}, steps = 501, byId = () => ({{ value: {speed} }});
    const draw = () => {{}}, requestAnimationFrame = () => {{}};
    let now = 0, playing = true, before = null;"""
    shown = "(() => { for (let k = 0; k <= 180; k++) tick(1000 * k / 60); return now; })()"
    assert abs(printed("tick", before, shown) - 150 * speed) <= 1


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="needs chromium")
def test_a_browser_draws_the_page(recorded: Film, tmp_path: Path) -> None:
    write_replay(tmp_path / "replay.html", {"pd": recorded}, "a title")
    ran = subprocess.run(
        [
            str(BROWSER), "--headless=new", "--no-sandbox", "--disable-gpu", "--dump-dom",
            "--enable-logging=stderr", "--virtual-time-budget=1000",
            f"file://{tmp_path / 'replay.html'}#step=20",
        ],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert "CONSOLE" not in ran.stderr
    clock = re.search(r'<output id="clock">(.*?)</output>', ran.stdout)
    assert clock is not None
    assert clock.group(1) == "0.40 s"
    assert '<h1 id="title">a title</h1>' in ran.stdout
    assert "% of reach</span>" in ran.stdout
