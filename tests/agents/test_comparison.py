"""Titles of evaluations, and their files."""

from pathlib import Path

import pytest

from agents import comparison
from agents.comparison import compare, titled
from agents.controllers.simple import Zero
from flexarm_env import IDS


@pytest.mark.parametrize(
    ("kwargs", "words"),
    [
        ({}, ""),
        ({"hardware": "laboratory", "obs": "sensors"}, " hardware=laboratory obs=sensors"),
        (
            {"hardware": {"preset": "laboratory", "payload": [0.5, 0.75], "gauge_noise": 0.1}},
            " hardware=laboratory (payload 0.5 to 0.75, gauge_noise 0.1)",
        ),
        ({"randomize": {"stiffness": (0.8, 1.2)}}, " randomize=(stiffness 0.8 to 1.2)"),
        ({"hardware": {"preset": "laboratory"}}, " hardware=laboratory"),
    ],
)
def test_titles_say_keywords_in_words(kwargs: dict[str, object], words: str) -> None:
    assert titled("FlexArm/OneLink-Reach-v0", kwargs) == "FlexArm/OneLink-Reach-v0" + words


def test_every_file_is_written_before_the_table_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pipe whose reader has gone ends the process in the table."""
    written: list[str] = []

    def unread(*_: object) -> None:
        raise SystemExit(1)

    for name in ("plot_recordings", "write_gif", "write_replay"):
        monkeypatch.setattr(comparison, name, lambda path, *_: written.append(path.name))
    monkeypatch.setattr(comparison, "film", lambda *_: None)
    monkeypatch.setattr(comparison, "print_table", unread)
    with pytest.raises(SystemExit):
        compare(
            {"zero": Zero(n_torque=1)}, next(iter(IDS)), {}, episodes=2, seed=0, folder=tmp_path
        )
    written += [path.name for path in tmp_path.iterdir()]
    files = "arm.gif evaluation.csv evaluation.json replay.html trajectories.png"
    assert sorted(written) == files.split()
