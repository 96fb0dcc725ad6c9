"""Settings of RL Zoo, as its files write them, are settings of experiments; none is evaluated."""

from pathlib import Path
from typing import Any

import pytest

from agents.config import Config, ConfigError, config_from_dict
from agents.learners.normalization import DEFAULTS
from dynamics.description.data_file import read_mapping
from tests.paths import ROOT

ENV = {"id": "FlexArm/OneLink-Reach-v0"}
FILES = sorted((ROOT / "configs" / "rl_zoo").glob("*.yml"))
BLOCKS = [(file.stem, key, block) for file in FILES for key, block in read_mapping(file).items()]


def pasted(name: str, settings: Any, env: Any = ENV, **rest: Any) -> Config:
    return config_from_dict({"env": env, "agent": {"name": name, "kwargs": settings}, **rest})


@pytest.mark.parametrize(("name", "key", "block"), BLOCKS, ids=lambda x: x if x != "" else None)
def test_every_shipped_block_is_an_experiment(name: str, key: str, block: Any) -> None:
    """And survives being written and read."""
    env = {"id": ENV["id"] if key == "default" else key}
    config = pasted(name, block, env)
    assert config.total_steps == block["n_timesteps"]
    assert config.env.n_envs == block["n_envs"]
    assert config.agent.policy == block["policy"]
    network = config.agent.kwargs["policy_kwargs"]
    assert network["activation_fn"] == {"ppo": "tanh", "sac": "relu"}[name]
    assert config_from_dict(config.to_dict()) == config


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_shipped_files_state_what_to_expect(path: Path) -> None:
    assert any(line.startswith("# Expected:") for line in path.read_text().splitlines())


def test_settings_of_the_zoo_go_to_their_places() -> None:
    config = pasted(
        "ppo",
        {
            "normalize": "{'norm_reward': False}", "device": "auto",
            "n_envs": 8, "n_timesteps": 1e5,
            "policy": "MlpPolicy", "env_kwargs": "dict(hardware='laboratory')", "frame_stack": 4,
            "n_steps": 64, "batch_size": 256, "learning_rate": "lin_3e-4", "clip_range": "lin_0.2",
            "use_sde": True, "sde_sample_freq": 4,
            "policy_kwargs": "dict(log_std_init=-2, ortho_init=False, activation_fn=nn.ReLU, "
            "net_arch=dict(pi=[256, 256], vf=[64]))",
        },
    )  # fmt: skip
    assert (config.env.n_envs, config.env.stack, config.total_steps) == (8, 4, 100_000)
    assert config.env.kwargs == {"hardware": "laboratory"}
    assert config.env.normalize == DEFAULTS | {"norm_reward": False}
    network = {"pi": [256, 256], "vf": [64]}
    policy = {"log_std_init": -2, "ortho_init": False, "activation_fn": "relu", "net_arch": network}
    others = {"n_steps": 64, "batch_size": 256, "use_sde": True, "sde_sample_freq": 4}
    others |= {"learning_rate": "lin_3e-4", "clip_range": "lin_0.2"}
    assert config.agent.kwargs == {"policy_kwargs": policy, **others}
    assert pasted("sac", {"train_freq": [8, "step"]}, total_steps=999).agent.kwargs == {
        "train_freq": 8
    }


HOSTILE = [
    "__import__('os').mkdir('made')",
    "dict(net_arch=__import__('os').mkdir('made'))",
    "dict(net_arch=[x for x in [64]])",
    "dict(activation_fn=nn.Module)",
    "dict(activation_fn=os.Tanh)",
    "dict(**{'net_arch': [64]})",
    "dict([('net_arch', [64])])",
    "list(net_arch=[64])",
    "dict(net_arch=(lambda: [64])())",
    "{64: 64}",
    "[64, 64]",
    "dict(net_arch=[64]",
    "dict(net_arch=" + 400 * "[" + 400 * "]" + ")",
    "dict(net_arch=" + 3000 * "1" + ")",
]


@pytest.mark.parametrize("text", HOSTILE, ids=lambda text: text[:40])
def test_a_text_that_is_no_plain_table_is_refused_and_not_run(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"agent\.kwargs\.policy_kwargs must be a table, or a"):
        pasted("ppo", {"policy_kwargs": text}, total_steps=9)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"normalize": "dict(norm_rewards=True)"}, "Unknown key 'norm_rewards' in env.normalize"),
        ({"device": "cuda"}, r"device must be one of \['cpu', 'auto'\], got 'cuda'"),
        ({"env_wrapper": "gym.wrappers.X"}, "env_wrapper of RL Zoo names code.*env.reward"),
        ({"callback": "x.Y"}, "callback of RL Zoo names code to import"),
        ({"n_envs": 4}, r"agent\.kwargs\.n_envs and env\.n_envs are one setting"),
        ({"n_timesteps": 4}, r"agent\.kwargs\.n_timesteps and total_steps are one setting"),
        ({"train_freq": [1, "episode"]}, r"train_freq must count steps.* got \[1, 'episode'\]"),
        ({"train_freq": [1]}, r"train_freq must count steps.* got \[1\]"),
        ({"train_freq": [1.5, "step"]}, r"train_freq must be an int, got 1\.5"),
        ({"policy_kwargs": "dict(net_arch=[1e3])"}, r"net_arch must list layer sizes"),
        ({"policy_kwargs": "dict(optimizer_class=nn.ReLU)"}, r"policy_kwargs\.optimizer_class"),
    ],
)
def test_settings_that_a_run_cannot_honour_are_refused(settings: Any, sentence: str) -> None:
    name = "sac" if "train_freq" in settings else "ppo"
    with pytest.raises(ConfigError, match=sentence):
        pasted(name, settings, ENV | {"n_envs": 8}, total_steps=1000)


def test_steps_of_a_zoo_file_are_whole() -> None:
    with pytest.raises(ConfigError, match=r"total_steps must be an int, got 1000\.5"):
        pasted("ppo", {"n_timesteps": 1000.5})
