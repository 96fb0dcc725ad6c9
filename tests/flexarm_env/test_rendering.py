"""Pictures without a display, and the generated pages."""

import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

import flexarm_env
from dynamics import ARMS
from flexarm_env import registration
from flexarm_env.core import Core
from flexarm_env.pages.environments import common_page, file_name, page
from flexarm_env.rendering import (
    FINE,
    GHOST,
    SHADOW,
    SIDE,
    SIZE,
    STEEL,
    STRIP_HEIGHT,
    TOP,
    Renderer,
)
from tests.paths import ROOT

TURNING = [n for n, arm in ARMS.items() if all(k.joint.type == "revolute" for k in arm.links)]
PAGES = ROOT / "docs" / "envs"


@pytest.mark.parametrize("scene", registration.SCENES)
def test_pictures_show_the_arm_and_change_as_it_moves(scene: str) -> None:
    env = gym.make(f"FlexArm/{scene}-Reach-v0", render_mode="rgb_array")
    env.reset(seed=0)
    before: Any = env.render()
    for _ in range(10):
        env.step(0.3 * env.action_space.high)
    after: Any = env.render()
    assert after.shape == (SIZE[1], SIZE[0], 3)
    assert after.dtype == np.uint8
    assert (np.abs(after.astype(int) - STEEL).sum(axis=2) < 30).sum() > 200
    assert not np.array_equal(before, after)
    shown = Image.fromarray(after)._repr_png_()  # by which a notebook shows it
    assert shown is not None
    assert shown.startswith(b"\x89PNG")


def pixels_of(picture: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((np.abs(picture.astype(int) - colour).sum(axis=2) < 6).sum())


@pytest.mark.parametrize("scene", registration.SCENES)
def test_the_rigid_arm_is_visible_beside_the_bent_one(scene: str) -> None:
    """Also where the arm is straight; on the floor a spatial arm has a shadow."""
    core = Core(task="Reach", arm=registration.SCENES[scene][0])
    core.q[0, list(core.arm.joint_index)] = 0.4
    renderer = Renderer(core)
    picture = renderer.draw(core)
    assert pixels_of(picture, GHOST) > 500
    assert (pixels_of(picture, SHADOW) > 200) == (not renderer.planar)


@pytest.mark.parametrize("height", [300, 480])
def test_pictures_are_drawn_at_their_height(height: int) -> None:
    core = Core(task="Reach", arm="slim")
    width = height * SIZE[0] // SIZE[1]
    assert Renderer(core, height).draw(core).shape == (height, width, 3)


@pytest.mark.parametrize("arm", TURNING)
def test_the_drawn_tip_is_the_measured_tip(arm: str) -> None:
    """The kinematics of the picture against that of the compiled arm."""
    core = Core(task="Reach", arm=arm)
    renderer = Renderer(core)
    rng = np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, core.arm.n)
    modal = [i for i in range(core.arm.base.n, core.arm.n) if i not in core.arm.joint_index]
    q[modal] *= 0.2 * np.array(core.scales.modal_scale)
    drawn = renderer.shapes(core, q, 1.0)[-1][-1]
    np.testing.assert_allclose(drawn, core.model.tip(q), atol=1e-12)


def test_brackets_and_roots_beside_joints_are_drawn() -> None:
    """Their corners by complex numbers; the picture has ink between a tip and the next joint."""
    rod = {"length": 0.4, "rho_A": 0.5}
    elbow = {"offset": [0.05, -0.2, 0.0], "root": [0.0, 0.1, 0.0]}
    core = Core(task="Reach", arm={"links": [rod, {**rod, "joint": elbow}]})
    renderer, q = Renderer(core), np.array([0.3, 0.5])
    turn, both = np.exp(0.3j), np.exp(0.8j)
    tip = 0.4 * turn
    joint = tip + (0.05 - 0.2j) * turn
    root = joint + 0.1j * both
    lines = renderer.shapes(core, q, 1.0)
    corners = [*lines[0][[0, -2, -1]], *lines[1][[0, 1, -1]]]
    expected = [0.0, tip, joint, joint, root, root + 0.4 * both]
    np.testing.assert_allclose([x + 1j * y for x, y, _ in corners], expected, atol=1e-14)

    core.q[0] = q
    middle = 0.5 * (tip + joint)
    x, y = renderer.pixels(np.array([middle.real, middle.imag, 0.0]))[0]
    assert renderer.draw(core)[round(y) // FINE, round(x) // FINE] @ (1, 1, 1) < 300
    bent, straight, _ = renderer.forms(core)
    np.testing.assert_allclose(bent[:, [0, -1]], straight, atol=1e-14)


def test_human_mode_needs_no_display() -> None:
    code = (
        "import gymnasium as gym, flexarm_env\n"
        "env = gym.make('FlexArm/OneLink-Reach-v0', render_mode='human')\n"
        "env.reset(seed=0)\nenv.step(env.action_space.sample())\n"
        "assert env.render() is None\nenv.close()"
    )
    environment = {"PATH": "/usr/bin", "HOME": str(Path.home()), "MPLBACKEND": "Agg"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, cwd=PAGES.parents[1])


def test_an_episode_is_filmed_by_gymnasiums_recorder(tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="the extra `video`")
    env: Any = gym.make("FlexArm/OneLink-Reach-v0", render_mode="rgb_array", max_episode_steps=5)
    env = gym.wrappers.RecordVideo(env, str(tmp_path))
    env.reset(seed=0)
    while not env.step(env.action_space.sample())[3]:
        pass
    env.close()
    assert (tmp_path / "rl-video-episode-0.mp4").stat().st_size > 1_000


def test_the_library_of_films_is_an_extra_that_the_tested_set_names() -> None:
    """And the page names the extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    (library,) = project["optional-dependencies"]["video"]
    assert "moviepy==" + library.partition(">=")[2] in (ROOT / "constraints.txt").read_text("utf-8")
    assert '-e ".[video]"' in common_page()


def test_a_floating_base_is_drawn_where_the_view_is_whatever_its_place() -> None:
    """Pictures of one posture at two places are equal."""
    arm = ARMS["free-flyer"]
    far = replace(arm, base=replace(arm.base, position=(30.0, -20.0, 0.0)))
    cores = [Core(task="Reach", arm=x) for x in (arm, far)]
    for core in cores:
        core.q[0, :2] = core.arm.base.position[:2]
        core.state[core.signals.state.slices["anchor"], 0] = core.q[0, :3]
    pictures = [Renderer(core).draw(core) for core in cores]
    assert np.mean(pictures[0] != pictures[1]) < 0.001


@pytest.mark.parametrize("segments", [1, 4])
def test_forms_have_their_points_at_even_distances(segments: int) -> None:
    """A replay exaggerates their distances from the same points of the straight link."""
    rod = {"length": 0.4, "rho_A": 0.5, "EIz": 2.0, "segments": segments}
    modes = [{"kind": "hierarchical", "index": k, "direction": "y"} for k in (1, 2)]
    core = Core(task="Reach", arm={"links": [{**rod, "modes": modes}]})
    (line,), (ends,), _ = Renderer(core).forms(core)
    np.testing.assert_allclose(line, np.linspace(*ends, len(line)), atol=1e-15)


@pytest.mark.parametrize("batch", [False, True])
def test_the_strip_begins_with_the_bending_at_the_start_of_every_episode(batch: bool) -> None:
    """A reset of other environments of a batch leaves it."""
    kwargs: Any = {"num_envs": 2, "autoreset_mode": "Disabled"} if batch else {}
    make: Any = gym.make_vec if batch else gym.make
    env = make("FlexArm/OneLink-Reach-v0", render_mode="rgb_array", **kwargs)
    for _ in range(2):
        q = np.linspace(0.0, 0.03, env.unwrapped.arm.n)
        _, info = env.reset(seed=0, options={"state": {"q": q}})
        env.render()
        renderer = env.unwrapped._renderer
        np.testing.assert_allclose(np.abs(renderer.bent), np.ravel(info["tip_deflection"])[:1])
        assert renderer.bent != [0.0]
        env.step(0.0 * env.action_space.sample())
        assert len(renderer.trail) == len(renderer.bent) == 2
    if batch:
        env.reset(options={"reset_mask": np.array([False, True])})
        assert len(renderer.trail) == len(renderer.bent) == 2


def test_batches_render_one_picture_per_environment() -> None:
    envs: Any = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=3, render_mode="rgb_array")
    envs.reset(seed=0)
    pictures = envs.render()
    assert [p.shape for p in pictures] == [(SIZE[1], SIZE[0], 3)] * 3
    assert not np.array_equal(pictures[0], pictures[1])


@pytest.mark.parametrize("env_id", flexarm_env.IDS)
def test_committed_pages_are_up_to_date(env_id: str) -> None:
    """If not: python -m flexarm_env.pages --out docs/envs"""
    assert (PAGES / file_name(env_id)).read_text(encoding="utf-8") == page(env_id)
    assert (PAGES / "README.md").read_text(encoding="utf-8") == common_page()


def test_a_close_up_holds_its_points_and_never_shrinks() -> None:
    core = Core(task="Reach", arm="six-link")
    core.q[0, list(core.arm.joint_index)] = 0.4
    renderer = Renderer(core)
    wide = renderer.scale
    points = np.concatenate(renderer.shapes(core, core.q[0], 1.0))
    renderer.close_up(points)
    assert renderer.scale > 1.2 * wide
    pixels = np.array(renderer.pixels(points)) / renderer.fine
    assert (pixels >= (SIDE - 1e-6, TOP - 1e-6)).all()
    assert (pixels <= (SIZE[0] - SIDE + 1e-6, SIZE[1] - STRIP_HEIGHT)).all()
    assert pixels_of(renderer.draw(core), STEEL) > pixels_of(Renderer(core).draw(core), STEEL)
    close = renderer.scale
    renderer.close_up(100.0 * points)
    assert renderer.scale == close
