"""Section `sweep` of an experiment: ranges are checked as the keywords are, and drawn by a seed."""

from typing import Any

import numpy as np
import pytest

from agents.config import Config, ConfigError, config_from_dict
from agents.learners.ranges import Draw, at_random, drawn, suggested
from agents.sweep.command import plan

PPO: dict[str, Any] = {"name": "ppo", "kwargs": {"learning_rate": "lin_1.0e-3", "n_steps": 64}}


def experiment(sweep: Any, agent: Any = PPO) -> Config:
    env = {"id": "FlexArm/OneLink-Reach-v0", "n_envs": 2}
    return config_from_dict({"env": env, "agent": agent, "total_steps": 1000, "sweep": sweep})


def random_draw() -> Draw:
    return at_random(np.random.default_rng(0))


def optunas_draw() -> Draw:
    """Suggestions of trials without a history."""
    optuna = pytest.importorskip("optuna")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))

    def draw(key: str, table: Any) -> Any:
        return suggested(study.ask())(key, table)

    return draw


@pytest.mark.parametrize("source", [random_draw, optunas_draw])
def test_drawn_values_lie_in_their_ranges_and_fill_them(source: Any) -> None:
    ranges = {
        "learning_rate": {"between": [1e-4, 1e-2], "log": True},
        "n_epochs": {"between": [2, 4]},
        "n_steps": {"between": [2, 4], "log": True},
        "batch_size": {"among": [32, 64]},
        "gamma": {"between": [0.9, 0.99]},
    }
    draw = source()
    found = [drawn(ranges, {}, draw) for _ in range(400)]
    for whole in ("n_epochs", "n_steps"):
        assert {x[whole] for x in found} == {2, 3, 4}
    assert {x["batch_size"] for x in found} == {32, 64}
    rates = np.array([x["learning_rate"] for x in found])
    assert 1e-4 <= rates.min() < 1.2e-4
    assert 0.8e-2 < rates.max() <= 1e-2
    assert 0.4 < np.mean(rates < 1e-3) < 0.6  # the middle of the logarithm
    gammas = np.array([x["gamma"] for x in found])
    assert 0.9 <= gammas.min() < 0.91 < 0.98 < gammas.max() <= 0.99


def test_a_falling_number_stays_falling() -> None:
    value = drawn({"clip_range": {"between": [0.1, 0.3]}}, {"clip_range": "lin_0.2"}, random_draw())
    assert 0.1 <= float(value["clip_range"].removeprefix("lin_")) <= 0.3
    assert value["clip_range"].startswith("lin_")


def test_the_first_trial_is_the_experiment_and_equal_seeds_draw_equal_trials() -> None:
    config = experiment({"gamma": {"between": [0.9, 0.99]}})
    assert config_from_dict(config.to_dict()) == config
    trials = plan(config, 5, seed=1)
    assert trials[0].agent == config.agent
    assert len({trial.agent.kwargs.get("gamma") for trial in trials}) == 5
    assert all(trial.sweep == {} for trial in trials)
    assert plan(config, 5, seed=1) == trials != plan(config, 5, seed=2)


@pytest.mark.parametrize(
    ("name", "keywords"),
    [("ppo", {"learning_rate", "gamma", "gae_lambda"}), ("sac", {"learning_rate", "gamma", "tau"})],
)
def test_without_the_section_an_algorithms_own_keywords_are_drawn(
    name: str, keywords: set[str]
) -> None:
    _, trial = plan(experiment({}, {"name": name}), 2, seed=0)
    assert set(trial.agent.kwargs) == keywords


@pytest.mark.parametrize(
    ("sweep", "sentence"),
    [
        ({"gama": {"between": [0.9, 0.99]}}, r"unknown key 'sweep\.gama'\. Did you mean 'gamma'"),
        ({"gamma": {"between": [0.9, 1.5]}}, r"sweep\.gamma must be between 0\.0 and 1\.0, got 1"),
        ({"gamma": {"between": [0.99, 0.9]}}, r"sweep\.gamma must be \{between: \[LOW, HIGH\]\}"),
        ({"gamma": {"between": [0.0, 0.9], "log": True}}, r"sweep\.gamma must be \{between"),
        ({"gamma": {"between": [0.9, True]}}, r"sweep\.gamma must be \{between"),
        ({"gamma": [0.9, 0.99]}, r"sweep\.gamma must be \{between: .*got \[0\.9, 0\.99\]"),
        ({"gamma": {"among": []}}, r"sweep\.gamma must be \{between"),
        ({"gamma": {"among": [0.9], "between": [0.9, 0.99]}}, r"sweep\.gamma must be \{between"),
        ({"n_steps": {"between": [16.0, 64.0]}}, r"sweep\.n_steps must be an int, got 16\.0"),
        ({"policy_kwargs": {"among": [3]}}, r"sweep\.policy_kwargs must be a table, got 3"),
    ],
)
def test_invalid_ranges_are_refused(sweep: Any, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        experiment(sweep)


def test_a_trial_that_could_not_run_is_refused_before_any_begins() -> None:
    config = experiment({"batch_size": {"among": [48]}})
    with pytest.raises(
        ConfigError, match=r"batch_size \(48\) must divide n_steps x n_envs \(128\)"
    ):
        plan(config, 2, seed=0)
