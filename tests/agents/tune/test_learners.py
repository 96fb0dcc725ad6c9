"""Keywords of learners: searched by trials that are trainings, on the tuning episodes."""

import gc
import json
import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.config import Config, load_config
from agents.controllers import CONTROLLERS
from agents.experiments import shipped_experiments
from agents.leaderboard.tracks import RANKED
from agents.learners.divergence import TrainingError
from agents.learners.export import export_policy
from agents.policy import Policy, save_policy
from agents.training import build_model
from agents.tune.__main__ import _placed, main
from agents.tune.learners import NINTHS, judged, place_of, trained, tune_experiment
from agents.tune.search import SEED
from agents.tuned import tuned
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


def test_a_training_begins_with_the_experiments_warm_start(tmp_path: Path) -> None:
    config = experiment(tmp_path)
    first = export_policy(build_model(replace(config, seed=7)), {})
    save_policy(first, tmp_path / "first")
    kwargs = config.agent.kwargs | {"learning_rate": 0.0}
    agent = replace(config.agent, warm_start=str(tmp_path / "first"), kwargs=kwargs)
    found = trained(replace(config, agent=agent))
    assert found is not None
    for ours, theirs in zip(found.weights, first.weights, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_training_frees_the_learner_of_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models: list[weakref.ref[Any]] = []

    def built(config: Config) -> Any:
        assert all(model() is None for model in models)
        model = build_model(config)
        models.append(weakref.ref(model))
        return model

    monkeypatch.setattr("agents.tune.learners.build_model", built)
    gc.disable()
    try:
        for _ in range(2):
            trained(experiment(tmp_path))
    finally:
        gc.enable()
    assert len(models) == 2


def test_the_first_trial_is_the_experiment_and_the_search_is_repeatable(tmp_path: Path) -> None:
    """Its score is that of plain trainings with three seeds, judged on the same episodes."""
    config = experiment(tmp_path, reward={"precision": 1.0})
    alone, first, again = (tune_experiment(config, trials=n, episodes=4) for n in (1, 5, 5))
    scores = []
    for seed in range(3):
        model = build_model(replace(config, seed=seed))
        model.learn(config.total_steps)
        scores.append(judged(config, export_policy(model, {}), 4, SEED)["score"])
        model.env.close()
    expected = np.mean(scores)
    assert first == again
    assert alone["parameters"] == {}
    assert alone["score"] == alone["untuned"] == first["untuned"] == expected
    assert first["score"] >= expected
    assert first["trials"] == 5


def test_the_best_mean_over_seeds_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A trial that is best with its first seed alone does not win; the scale is searched too."""
    path = write_config(tmp_path, "ppo", STEPS)
    path.write_text(path.read_text() + "base: {controller: lqr, scale: 0.3}\n")
    seen: list[Config] = []

    def train(config: Config, poor: Any = None) -> Config:
        seen.append(config)
        return config

    def judge(config: Config, policy: Any, *more: Any) -> dict[str, float]:
        """With the first seed the last trial is the best one, with others the fourth."""
        own = [x for x in seen if x.seed == 0].index(replace(policy, seed=0))
        value = float(own) if policy.seed == 0 else 6.0 - 3.0 * abs(own - 3)
        return {"score": value, "objective": value}

    monkeypatch.setattr("agents.tune.learners.trained", train)
    monkeypatch.setattr("agents.tune.learners.judged", judge)
    config = load_config(path)
    found = tune_experiment(config, trials=6, episodes=2)
    trials = [x for x in seen if x.seed == 0]
    assert trials[0] == config
    assert [x.seed for x in seen] == 6 * [0] + 4 * [1, 2]
    assert {trials.index(replace(x, seed=0)) for x in seen[6:]} == {0, 3, 4, 5}
    assert found["score"] == (3.0 + 6.0 + 6.0) / 3.0
    assert found["untuned"] == (0.0 - 3.0 - 3.0) / 3.0
    assert set(found["parameters"]) == {"learning_rate", "gamma", "gae_lambda", "scale"}
    assert trials[3].base is not None
    assert trials[3].agent.kwargs | {"scale": trials[3].base.scale} == (
        config.agent.kwargs | found["parameters"]
    )
    assert 0.03 <= trials[3].base.scale <= 1.0


def test_a_training_that_diverges_is_told(tmp_path: Path) -> None:
    config = experiment(tmp_path)
    kwargs = config.agent.kwargs | {"learning_rate": 10.0, "max_grad_norm": 1.0e6, "n_epochs": 9}
    with pytest.raises(TrainingError, match="the training has diverged"):
        trained(replace(config, agent=replace(config.agent, kwargs=kwargs), total_steps=100_000))


def test_a_search_outlives_trials_that_diverge_and_keywords_that_exclude_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Config] = []
    told: list[str] = []

    def train(config: Config, poor: Any = None) -> Config:
        seen.append(config)
        if len(seen) == 2 or config.seed == 2:
            raise TrainingError("it has diverged.")
        return config

    monkeypatch.setattr("agents.tune.learners.trained", train)
    monkeypatch.setattr(
        "agents.tune.learners.judged", lambda *given: {"score": 1.0, "objective": 1.0}
    )
    sweep = {"batch_size": {"among": [64, 100]}, "gamma": {"between": [0.9, 0.99]}}
    config = replace(experiment(tmp_path), sweep=sweep)
    found = tune_experiment(config, trials=9, episodes=2, report=told.append)
    assert (found["trials"], found["untuned"]) == (9, (1.0 + 1.0 + 0.0) / 3.0)
    finalists = sum("seed 2" in line for line in told)
    assert told.count("it has diverged.") == 1 + finalists  # a trial, and a seed of each
    assert finalists > 1
    assert "must divide" in " ".join(told)


def test_an_experiment_that_diverges_itself_ends_its_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def train(*given: Any) -> None:
        raise TrainingError("it has diverged.")

    monkeypatch.setattr("agents.tune.learners.trained", train)
    path = str(write_config(tmp_path, "ppo", STEPS))
    arguments = ["--experiments", path, "--out", str(tmp_path / "t"), "--keep", str(tmp_path / "k")]
    assert main(arguments) == 2
    assert "it has diverged." in one_sentence(capsys)


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
    cold = write_config(tmp_path, "ppo", STEPS)
    cold.write_text(cold.read_text().replace("agent:", "agent:\n  warm_start: nothing"))
    options = ["--trials", "2", "--keep", str(tmp_path / "keep"), "--out", str(out)]
    assert main(["--experiments", str(cold), *options]) == 2
    assert "agent.warm_start: neither a run nor a shipped" in one_sentence(capsys)
    assert not out.exists()


def test_two_experiments_of_one_place_are_refused_before_either_is_searched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One result is stored there; the same experiment named twice is one."""
    config, out = write_config(tmp_path, "ppo", STEPS), tmp_path / "tuned.json"
    other = config.with_name("mine.yaml")
    other.write_text(config.read_text())
    options = ["--trials", "1", "--episodes", "2", "--out", str(out), "--keep", str(tmp_path / "k")]
    assert main(["--experiments", str(config), str(other), *options]) == 2
    assert f"tiny_ppo and mine have one place, {ENV_ID}, state, ppo," in one_sentence(capsys)
    assert not out.exists()
    assert _placed([str(config)] * 2) == {(ENV_ID, "state", "ppo"): load_config(config)}


def test_shipped_experiments_have_the_keywords_that_were_found() -> None:
    experiments = {place_of(config): config for config in map(load_config, ranked())}
    found = {
        (env_id, track, name): entry
        for env_id, tracks in tuned().items()
        for track, entries in tracks.items()
        for name, entry in entries.items()
        if name not in CONTROLLERS
    }
    assert found
    for place, entry in found.items():
        config = experiments[place]
        have = config.agent.kwargs | ({"scale": config.base.scale} if config.base else {})
        assert have | entry["parameters"] == have, place
        assert config.total_steps == entry["steps"], place


def ranked() -> list[Path]:
    """Shipped experiments on a track."""
    experiments = shipped_experiments().values()
    return [x for x in experiments if load_config(x).env.id in RANKED]


def test_policies_are_named_as_they_are_ranked(tmp_path: Path) -> None:
    path = write_config(tmp_path, "ppo", STEPS, kwargs={"hardware": "laboratory"}, stack=4)
    assert place_of(load_config(path)) == (ENV_ID, "laboratory", "ppo-stacked")
    path.write_text(path.read_text() + "base: {controller: lqg, learned: advised}\n")
    assert place_of(load_config(path)) == (ENV_ID, "laboratory", "ppo-advised-by-lqg-stacked")
