"""Keywords of learners: searched by trials that are trainings, on the tuning episodes."""

import json
from pathlib import Path
from typing import Any

import pytest

from agents.config import Config, load_config
from agents.learners.export import export_policy
from agents.learners.tuning import NINTHS, judged, place_of, trained, tune_experiment
from agents.policy import Policy
from agents.training import build_model
from agents.tune import SEED, main
from tests.agents.tiny import ENV_ID, one_sentence, write_config

STEPS = 1152  # nine rollouts


def experiment(tmp_path: Path, **env: Any) -> Config:
    return load_config(write_config(tmp_path, "ppo", STEPS, **env))


def test_a_training_is_asked_at_a_ninth_and_a_third_of_its_steps(tmp_path: Path) -> None:
    asked: list[tuple[int, int]] = []

    def poor(policy: Policy, rung: int) -> bool:
        asked.append((policy.about["steps"], rung))
        return len(asked) == 4

    config = experiment(tmp_path)
    first = trained(config, poor)
    assert first is not None
    assert first.about["steps"] == STEPS
    assert asked == [(STEPS // NINTHS, 1), (3 * STEPS // NINTHS, 3)]
    assert trained(config, poor) is None  # it ended at its second question
    assert len(asked) == 4


def test_the_first_trial_is_the_experiment_and_the_search_is_repeatable(tmp_path: Path) -> None:
    """The score of the first is that of a plain training, judged on the same episodes."""
    config = experiment(tmp_path, reward={"precision": 1.0})
    alone, first, again = (tune_experiment(config, trials=n, episodes=4) for n in (1, 5, 5))
    model = build_model(config)
    model.learn(config.total_steps)
    expected = judged(config, export_policy(model, {}), 4, SEED)["score"]
    model.env.close()
    assert first == again
    assert alone["parameters"] == {}
    assert alone["score"] == alone["untuned"] == first["untuned"] == expected
    assert first["score"] >= expected
    assert first["trials"] == 5


def test_what_a_base_adds_is_searched_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever trial wins, its keywords and scale are those that it was trained with."""
    path = write_config(tmp_path, "ppo", STEPS)
    path.write_text(path.read_text() + "base: {controller: lqr, scale: 0.3}\n")
    seen: list[Config] = []

    def record(config: Config, poor: Any) -> Any:
        seen.append(config)
        return trained(config, poor)

    monkeypatch.setattr("agents.learners.tuning.trained", record)
    monkeypatch.setattr(
        "agents.learners.tuning.judged",
        lambda *_: {"score": float(len(seen)), "objective": float(len(seen))},
    )
    found = tune_experiment(load_config(path), trials=3, episodes=2)
    own, *_, last = seen
    assert own.base is not None
    assert last.base is not None
    assert own.base.scale == 0.3
    assert (found["untuned"], found["score"]) == (1.0, 3.0)
    assert set(found["parameters"]) == {"learning_rate", "gamma", "gae_lambda", "scale"}
    assert last.agent.kwargs | {"scale": last.base.scale} == (
        own.agent.kwargs | found["parameters"]
    )
    assert 0.03 <= last.base.scale <= 1.0


def test_a_command_stores_what_it_finds_where_the_policy_is_ranked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tuned.json"
    config = str(write_config(tmp_path, "ppo", STEPS))
    options = ["--trials", "2", "--episodes", "2", "--out", str(out)]
    assert main(["--experiments", config, *options]) == 0
    assert "as it is" in capsys.readouterr().out
    assert json.loads(out.read_text())[ENV_ID]["state"]["ppo"]["trials"] == 2


def test_experiments_that_cannot_be_ranked_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tuned.json"
    config = str(write_config(tmp_path, "ppo", STEPS, kwargs={"torque_limit": 3.0}))
    assert main(["--experiments", config, "--out", str(out)]) == 2
    assert "is not on a track" in one_sentence(capsys)
    assert main(["--experiments", "none.yaml", "--out", str(out)]) == 2
    assert "there is no such file" in one_sentence(capsys)
    assert not out.exists()


def test_policies_are_named_as_they_are_ranked(tmp_path: Path) -> None:
    path = write_config(tmp_path, "ppo", STEPS, kwargs={"hardware": "laboratory"}, stack=4)
    assert place_of(load_config(path)) == (ENV_ID, "laboratory", "ppo-stacked")
    path.write_text(path.read_text() + "base: {controller: lqg, learned: advised}\n")
    assert place_of(load_config(path)) == (ENV_ID, "laboratory", "ppo-advised-by-lqg-stacked")
