"""Experiment files are read strictly; every refusal names the key and the value."""

import os
from pathlib import Path

import pytest

from agents.config import Config, ConfigError, config_from_dict, load_config
from tests.paths import ROOT

CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))
GOOD = """
env: {id: FlexArm/OneLink-Reach-v0, n_envs: 4, reward: {tracking: 1.0}}
agent: {name: ppo, kwargs: {n_steps: 64, batch_size: 128, learning_rate: lin_3.0e-4}}
total_steps: 300_000
"""


def load(tmp_path: Path, text: str) -> Config:
    path = tmp_path / "experiment.yaml"
    path.write_text(text, encoding="utf-8")
    return load_config(path)


def test_a_config_survives_being_written_and_read(tmp_path: Path) -> None:
    config = load(tmp_path, GOOD)
    assert config.name == "experiment"
    assert config.total_steps == 300_000
    assert config_from_dict(config.to_dict()) == config


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_shipped_configs_load(path: Path) -> None:
    assert load_config(path).name == path.stem


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("300_000", "3e5", r"total_steps must be an int, got '3e5' \(write 300_000\)\."),
        ("300_000", "1.5", r"total_steps must be an int, got 1\.5\."),
        ("300_000", "true", r"total_steps must be an int, got True\."),
        ("300_000", "-5", r"total_steps must be between 1 and 100_000_000_000, got -5\."),
        ("300_000", "1" + "0" * 30, r"total_steps must be between 1 and 100_000_000_000, got 1000"),
        ("300_000", "0x" + "f" * 5000, "total_steps must be between .* got a"),
        ("n_envs: 4", "n_envs: 1000000000000", r"env\.n_envs must be between 1 and 65_536, got 1"),
        ("Reach-v0", "ReachGoal-v0", "with obs: goal has dicts .*; choose an id without goals"),
        ("n_envs: 4", "n_envs: 4, kwargs: {obs: goal}", "with obs: goal has dicts"),
        ("n_steps: 64", "n_steps: 5_000_064", r"agent\.kwargs\.n_steps must be between 1 and 1_0"),
        (
            "n_steps: 64",
            "n_steps: 64, gamma: .inf",
            r"gamma must be between 0\.0 and 1\.0, got inf",
        ),
        ("n_steps: 64", "n_steps: 64, clip_range: -0.2", r"clip_range must be .*, got -0\.2\."),
        ("n_steps: 64", "n_steps: 64, clip_range: lin_-0.2", r"clip_range must be .*, got -0\.2\."),
        ("n_steps: 64", "n_steps: 64, max_grad_norm: 0.0", r"max_grad_norm must be .*, got 0\.0\."),
        (
            "name: ppo, kwargs: {n_steps: 64, batch_size: 128, learning_rate: lin_3.0e-4}",
            "name: td3, kwargs: {target_policy_noise: -0.2}",
            r"target_policy_noise must be between 0\.0 and .*, got -0\.2\.",
        ),
        (
            "name: ppo, kwargs: {n_steps: 64, batch_size: 128, learning_rate: lin_3.0e-4}",
            "name: tqc, kwargs: {top_quantiles_to_drop_per_net: 25}",
            r"top_quantiles_to_drop_per_net \(25\) must be below the number of quantiles \(25\)",
        ),
        (
            "name: ppo, kwargs: {n_steps: 64, batch_size: 128, learning_rate: lin_3.0e-4}",
            "name: sac, kwargs: {learning_starts: 300_000}",
            r"learning_starts \(300_000\) must be below total_steps \(300_000\), or nothing is l",
        ),
        (
            "name: ppo, kwargs: {n_steps: 64, batch_size: 128, learning_rate: lin_3.0e-4}",
            "name: sac, kwargs: {gradient_steps: 0}",
            r"gradient_steps must not be 0, or nothing is l",
        ),
        (
            "name: ppo, kwargs: {n_steps: 64, batch_size: 128, learning_rate: lin_3.0e-4}",
            "name: dagger, kwargs: {buffer_size: 9}}\nbase: {controller: pd, learned: distilled",
            r"buffer_size \(9\) must be at least total_steps \(300_000\) for dagger",
        ),
        (
            "n_envs: 4",
            "n_envs: 4, kwargs: {reward: {}}",
            r"env\.reward and env\.kwargs\.reward are one",
        ),
        ("lin_3.0e-4", "lin_inf", r"learning_rate must be between 0\.0 and 10\.0, got inf"),
        ("lin_3.0e-4", "1.0e+300", r"learning_rate must be between 0\.0 and 10\.0, got 1e\+300"),
        ("tracking: 1.0", "tracking: .inf", r"reward\.tracking must be between -1_000_000\.0 and"),
        ("n_steps: 64", "n_steps: 64, vf_coef: -.inf", r"vf_coef must be between .* got -inf"),
        (
            "n_steps: 64",
            "n_steps: 64, policy_kwargs: {net_arch: [1000000]}",
            r"net_arch must have at most 8 layers of at most 2048 units, got \[1000000\]",
        ),
        (
            "n_steps: 64",
            "n_steps: 64, policy_kwargs: {net_arch: {pi: [8, 8, 8, 8, 8, 8, 8, 8, 8]}}",
            r"net_arch must have at most 8 layers",
        ),
        (
            "n_envs: 4",
            "n_envs: 4, kwargs: {max_episode_steps: -1}",
            r"env\.kwargs\.max_episode_steps must be a number of control steps, got -1: episodes w",
        ),
        (
            "total_steps",
            "seed: 4294967296\ntotal_steps",
            "seed must be between 0 and 2_147_483_647",
        ),
        (
            "total_steps",
            "name: ../../x\ntotal_steps",
            r"name must be the plain name of a folder",
        ),
        ("total_steps", f"name: 1{400 * '0'}\ntotal_steps", "name must be text, got 1000"),
        ("total_steps", "name: .hidden\ntotal_steps", r"name must be the plain name of a folder"),
        ("total_steps", "name: $x$\ntotal_steps", r"name must be the plain name of a folder"),
        ("total_steps", "total_steps: 1\ntotal_steps", r"total_steps.* stand twice"),
        ("n_steps: 64", "n_steps: 64, n_steps: 64", r"n_steps.* stand twice"),
        (
            "name: ppo, kwargs: {n_steps: 64, batch_size: 128, learning_rate: lin_3.0e-4}",
            "name: sac, kwargs: {ent_coef: auto_inf}",
            r"ent_coef must be a number, 'auto' or 'auto_NUMBER', got 'auto_inf'",
        ),
        ("total_steps", "n_timesteps", r"unknown key 'n_timesteps'\. Here it is total_steps\."),
        ("n_steps", "n_step", r"unknown key 'agent\.kwargs\.n_step'\. Did you mean 'n_steps'\?"),
        ("lin_3.0e-4", "3e-4", r"learning_rate must be a number, got '3e-4' .*write 3\.0e-4"),
        ("lin_3.0e-4", "lin_x", r"learning_rate must be a number or 'lin_NUMBER', got 'lin_x'"),
        ("lin_3.0e-4", ".nan", r"learning_rate must be .*, got nan"),
        ("128", "100", r"batch_size \(100\) must divide n_steps x n_envs \(256\)"),
        ("name: ppo", "name: dqn", "dqn chooses among discrete actions, but an arm takes torques"),
        ("name: ppo", "name: PPO", r"agent\.name must be one of \['a2c', .*\], got 'PPO'"),
        ("id: FlexArm/OneLink-Reach-v0, ", "", r"env\.id is missing"),
        ("tracking: 1.0", "tracking: high", r"env\.reward\.tracking must be a number, got 'high'"),
        ("total_steps", "device: gpu\ntotal_steps", r"device must be one of .*, got 'gpu'"),
        ("total_steps", "device: cuda\ntotal_steps", r"'cpu' for ppo, .*agent\.name: rsl-ppo"),
        ("agent: {", "agent: [", r"is not valid YAML: .* line 3"),
    ],
)
def test_invalid_files_are_refused(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        load(tmp_path, GOOD.replace(old, new, 1))


def test_a_rollout_beyond_memory_is_refused(tmp_path: Path) -> None:
    text = GOOD.replace("n_envs: 4", "n_envs: 65536").replace("n_steps: 64", "n_steps: 512")
    with pytest.raises(ConfigError, match="n_steps x n_envs must be at most 16_777_216, got 33_5"):
        load(tmp_path, text)


@pytest.mark.parametrize("text", ["", "[]", "5"])
def test_other_yaml_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match="must hold a mapping at the top"):
        load(tmp_path, text)


def test_tables_may_share_what_they_have_in_common(tmp_path: Path) -> None:
    """By YAML's merge key, whose values a table's own keys replace; own keys stand once."""
    shared = "agent: {name: ppo, kwargs: {<<: &k {n_steps: 9, batch_size: 128}, n_steps: 64}}"
    text = GOOD.splitlines()
    text[2] = shared
    assert load(tmp_path, "\n".join(text)).agent.kwargs == {"n_steps": 64, "batch_size": 128}
    text[2] = shared.replace("n_steps: 64", "n_steps: 64, n_steps: 32")
    with pytest.raises(ConfigError, match=r"n_steps.* stand twice"):
        load(tmp_path, "\n".join(text))


def test_a_file_cannot_run_code(tmp_path: Path) -> None:
    made = tmp_path / "made"
    with pytest.raises(ConfigError, match="is not valid YAML"):
        load(tmp_path, f"!!python/object/apply:os.mkdir [{made}]")
    assert not made.exists()


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no such file"):
        load_config(tmp_path / "none.yaml")


def test_a_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(ConfigError, match="there is no such file"):
        load_config(tmp_path / "pipe.yaml")


def test_messages_shorten_long_values(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, GOOD.replace("300_000", "x" * 10_000))
    assert len(str(caught.value).removeprefix(str(tmp_path))) < 200
