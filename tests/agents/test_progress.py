"""Progress on a terminal and in a pipe, and titles of pictures."""

import io
import sys
from pathlib import Path
from typing import Any

import pytest

from agents import figures
from agents.comparison import compare
from agents.controllers import controller, joint_pd
from agents.metrics import make_batch, progress, record
from agents.run_folder.callback import Progress

ENV_ID = "FlexArm/OneLink-Reach-v0"
MEANS = {"return": 1.0, "settled": 0.5}


@pytest.mark.parametrize(("total", "rollout"), [(1000, 30), (1000, 1000), (1000, 170), (5, 16)])
def test_piped_progress_ends_at_100_percent(
    total: int, rollout: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whole rollouts go beyond the total; a resumed run begins where it was."""
    for done in (0, total // 2):
        bar = Progress(total, done)
        for steps in range(done + rollout, total + rollout, rollout):
            bar.update(steps, 1.0, MEANS)
        bar.close()
        lines = capsys.readouterr().out.splitlines()
        shares = [int(line.split()[1]) for line in lines]
        assert shares[-1] == 100
        assert shares.count(100) == 1
        assert len(lines) <= 12
        assert shares == sorted(shares)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_bars_are_for_terminals_and_for_labels(monkeypatch: pytest.MonkeyPatch) -> None:
    for stream, label, shown in (
        (Terminal(), "film", True), (Terminal(), None, False), (io.StringIO(), "film", False),
    ):  # fmt: skip
        monkeypatch.setattr(sys, "stderr", stream)
        bar = progress(label, 10)
        bar.update(5)
        bar.refresh()
        bar.close()
        assert ("film:  50%" in stream.getvalue()) == shown


def test_the_evaluation_shows_its_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    envs = make_batch(ENV_ID, 2, {"max_episode_steps": 5})
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    record(controller("zero", envs), envs, (0, 1), "evaluating")
    assert "evaluating:   0%" in terminal.getvalue()
    assert "0/5" in terminal.getvalue()


def test_pictures_are_titled_by_what_was_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Id and keywords in the title, controllers in the legend."""
    drawn: dict[str, Any] = {}
    monkeypatch.setattr(
        figures, "save_figure", lambda figure, path: drawn.setdefault(path.name, figure)
    )
    kwargs = {"max_episode_steps": 5, "control_dt": 0.02}
    envs = make_batch(ENV_ID, 1, kwargs)
    pd = joint_pd(envs, 1.0, 1.0)
    compare({"joint PD": pd}, ENV_ID, kwargs, episodes=2, seed=3, folder=tmp_path)
    axes = drawn["trajectories.png"].axes[0]
    wanted = f"{ENV_ID} max_episode_steps=5 control_dt=0.02"
    assert axes.get_title(loc="left") == f"{wanted}, 2 episodes"
    assert [text.get_text() for text in drawn["trajectories.png"].legends[0].texts] == ["joint PD"]
    figures.plot_learning_curve(tmp_path / "curve.png", {"a": []}, f"ppo, seed 0, on {wanted}")
    assert drawn["curve.png"].axes[0].get_title(loc="left") == f"ppo, seed 0, on {wanted}"


def test_a_learning_curve_of_one_point_has_a_marker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(figures, "save_figure", lambda figure, path: drawn.append(figure))
    rows = [{"steps": 10.0 * k, "return": 1.0 * k, "settled": 0.5} for k in (1, 2)]
    figures.plot_learning_curve(tmp_path / "a.png", {"one": rows[:1], "two": rows}, "title")
    markers = [line.get_marker() for line in drawn[0].axes[0].lines]
    assert markers == ["o", "None"]


def test_a_rigid_arm_is_evaluated_too(tmp_path: Path) -> None:
    """It has no curvature at any root."""
    kwargs = {"arm": "puma-600", "max_episode_steps": 5}
    envs = make_batch("FlexArm/SixLink-Reach-v0", 1, kwargs)
    pd = joint_pd(envs, 1.0, 1.0)
    found = compare(
        {"pd": pd}, "FlexArm/SixLink-Reach-v0", kwargs, episodes=2, seed=0, folder=tmp_path
    )
    assert found["pd"]["peak_root_curvature"].tolist() == [0.0, 0.0]
    assert (tmp_path / "replay.html").is_file()
