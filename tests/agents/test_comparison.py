"""Titles of evaluations, and their files."""

from pathlib import Path

import pytest
from matplotlib.text import Text

from agents import comparison, figures
from agents.comparison import compare, titled
from agents.controllers.simple import Zero
from agents.evaluate import make_controller
from agents.metrics import make_batch, record
from agents.policy import load_policy
from flexarm_env import IDS
from tests.agents.export.kinds import ENV_ID, policy_of
from tests.paths import ROOT


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


@pytest.mark.parametrize(
    ("subject", "name"), [("runs/first/", "first"), (".", "here"), ("runs/p\udcf6l", "p?l")]
)
def test_a_policy_is_named_as_its_folder(
    subject: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In letters that a file can hold: a name of bytes that are no text is none."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    keywords = {"hardware": "laboratory"}
    assert make_controller(subject, policy_of("tanh"), ENV_ID, keywords)[0] == name


def test_observations_that_are_as_many_but_other_quantities_are_refused() -> None:
    """Exact states of two links, and sensors with a path: sixteen numbers each."""
    two, path = "FlexArm/TwoLink-Reach-v0", "FlexArm/TwoLink-Track-v0"
    policy = load_policy(ROOT / "agents/policies/TwoLink-Reach-v0/state/dagger-of-mpc/seed0")
    make_controller("reach", policy, two, {})
    with pytest.raises(
        ValueError, match=r"'state', but .*Track.* as many .* 'sensors with a path'"
    ):
        make_controller("reach", policy, path, {"hardware": "laboratory"})


def test_charts_show_names_and_titles_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dollar signs of a folder began formulas, and broken ones ended the evaluation."""
    name, drawn = r"a$\frac$b", []
    monkeypatch.setattr(figures, "save_figure", lambda figure, _: drawn.append(figure))
    found = record(Zero(n_torque=1), make_batch(ENV_ID, 2, {}), [0, 1], name)
    figures.plot_recordings(tmp_path, {name: found}, name)
    rows = [{"steps": k, "return": float(k), "settled": 0.5} for k in range(3)]
    figures.plot_learning_curve(tmp_path, {name: rows, "other": rows}, name)
    figures.draw_strips({name: found}, 400, name)
    texts = [text for figure in drawn for text in figure.findobj(Text) if text.get_text() == name]
    assert [text.get_parse_math() for text in texts] == 4 * [False]
