"""PPO on tensors: the critic's input, the stored actor with its frames, and refusals."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from agents.config import ConfigError, config_from_dict
from agents.learners.export import begin_with, export_policy
from agents.learners.rsl import floor_share, grouped
from agents.training import build_model
from agents.training import main as train
from tests.agents.tiny import ENV_ID, KWARGS, one_sentence, write_config
from tests.paths import ROOT

CELLS = {"net_arch": [8], "lstm_hidden_size": 12, "n_lstm_layers": 2}


def model(env: dict[str, Any] | None = None, policy: str = "MlpPolicy", **kwargs: Any) -> Any:
    pytest.importorskip("rsl_rl")
    arms = {"id": ENV_ID, "n_envs": 8, "kwargs": {"max_episode_steps": 12}}
    agent = {"name": "rsl-ppo", "policy": policy, "kwargs": KWARGS["rsl-ppo"] | kwargs}
    return build_model(
        config_from_dict({"env": arms | (env or {}), "agent": agent, "total_steps": 256})
    )


def remembering(**kwargs: Any) -> Any:
    return model(policy="MlpLstmPolicy", policy_kwargs=CELLS, **kwargs)


@pytest.mark.parametrize("build", [model, remembering])
def test_the_stored_policy_acts_as_the_actor_over_ends_of_episodes(build: Any) -> None:
    """The memory of NumPy's policy beside that of the batch, and two forms of one network."""
    learner = build(env={"stack": 3})
    policy, state, starts = export_policy(learner, {"stack": 3}), None, np.ones(8, bool)
    obs, size = learner.env.reset(), policy.n_observation
    for _ in range(30):
        newest = obs["observation"][:, -size:].numpy()
        action, state = policy.predict(newest, state, starts)
        expected = learner.policy["actor"](grouped(obs)).clamp(-1.0, 1.0).detach()
        np.testing.assert_allclose(action, expected.numpy(), atol=5e-6)
        obs, _, ended, _, _ = learner.env.step(torch.rand(8, 1) - 0.5)
        learner.policy["actor"].reset(ended)
        starts = ended.numpy()


def test_cells_learn_from_the_actions_as_they_were_taken() -> None:
    """Probabilities over whole rollouts beside those of single steps, over ends of episodes."""
    learner, largest = remembering(batch_size=64), []
    update = learner.train

    def watched() -> None:
        actor, storage = learner.policy["actor"], learner.ppo.storage
        for batch in storage.recurrent_mini_batch_generator(2, 1):
            actor(batch.observations, batch.masks, batch.hidden_states[0], stochastic_output=True)
            again = actor.get_output_log_prob(batch.actions)
            change = again.detach() - batch.old_actions_log_prob.squeeze(-1)
            largest.append(float(change.abs().max()))
        update()

    learner.train = watched
    learner.learn(256, log_interval=None)
    learner.learn(256, log_interval=None)  # begins new episodes
    assert len(largest) == 8
    assert max(largest) < 1e-5


def test_cells_begin_with_those_of_another_library() -> None:
    kwargs = {"n_steps": 16, "batch_size": 32, "policy_kwargs": CELLS}
    agent = {"name": "recurrent-ppo", "kwargs": kwargs}
    theirs = build_model(
        config_from_dict({"env": {"id": ENV_ID, "n_envs": 8}, "agent": agent, "total_steps": 256})
    )
    learner, memory = remembering(), None
    begin_with(learner, export_policy(theirs, {}), {})
    for _ in range(5):
        seen = 2.0 * torch.rand(8, learner.observation_space.shape[0]) - 1.0
        action = learner.policy["actor"](grouped({"observation": seen})).clamp(-1.0, 1.0)
        expected, memory = theirs.predict(seen.numpy(), memory, deterministic=True)
        np.testing.assert_allclose(action.detach().numpy(), expected, atol=5e-6)


def test_only_the_critic_learns_from_the_true_state() -> None:
    learner = model()
    actor, critic = learner.policy["actor"], learner.policy["critic"]
    learner.learn(256, log_interval=None)
    obs = learner._last_obs.clone()
    action, value = actor(obs), critic(obs)
    obs["privileged"] += 0.1
    assert torch.equal(actor(obs), action)
    assert bool((critic(obs) != value).all())


def test_the_rate_adapts_only_to_a_wanted_divergence() -> None:
    rates = []
    for wanted in ({}, {"desired_kl": 1e-6}):
        learner = model(**wanted)
        learner.learn(256, log_interval=None)
        rates.append(learner.ppo.optimizer.param_groups[0]["lr"])
    assert rates[0] == pytest.approx(1e-3)
    assert rates[1] < 1e-3


def test_the_standard_deviation_stays_above_a_floor_that_falls_at_the_end() -> None:
    assert [floor_share(x) for x in (0.0, 0.7, 1.0)] == pytest.approx([1.0, 1.0, 0.2])
    learner = model(std_floor=0.5, policy_kwargs={"log_std_init": -4.0})
    learner.learn(64, log_interval=None)
    log_std = learner.policy["actor"].distribution.log_std_param.detach()
    assert float(log_std.exp()) == pytest.approx(0.1)  # the run is at its end


def test_the_critic_first_learns_alone() -> None:
    learner, seen = model(critic_first=0.6), []
    update = learner.train

    def watched() -> None:
        before = [x.clone() for x in learner.policy.parameters()]
        update()
        moved = [
            bool((a != b).any()) for a, b in zip(before, learner.policy.parameters(), strict=True)
        ]
        n_actor = len(list(learner.policy["actor"].parameters()))
        seen.append((any(moved[:n_actor]), any(moved[n_actor:])))

    learner.train = watched
    learner.learn(256, log_interval=None)
    assert seen == [(False, True), (True, True)]


def test_first_episodes_are_spread_over_their_length() -> None:
    arms = model().env
    ends = []
    for spread in (False, True):
        arms.reset()
        if spread:
            arms.spread()
        ends.append([int(arms.step(torch.zeros(8, 1))[2].sum()) for _ in range(12)])
    assert ends[0] == [*[0] * 11, 8]
    assert sum(ends[1]) == 8
    assert max(ends[1]) < 8


def test_minibatches_of_cells_are_whole_rollouts() -> None:
    with pytest.raises(ConfigError, match=r"batch_size \(8\) must be a multiple of n_steps \(16\)"):
        remembering(batch_size=8)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"env": {"normalize": True}}, r"env\.normalize is not for rsl-ppo: leave it out"),
        ({"base": {"controller": "pd"}}, "base is not for rsl-ppo: leave it out"),
    ],
)
def test_what_tensors_do_not_have_is_refused(changed: dict[str, Any], sentence: str) -> None:
    data = {"env": {"id": ENV_ID} | changed.get("env", {}), "agent": {"name": "rsl-ppo"}}
    data["agent"]["kwargs"] = {"batch_size": 32}
    with pytest.raises(ConfigError, match=sentence):
        config_from_dict(changed | data | {"total_steps": 256})


def test_the_experiment_of_the_page_is_one() -> None:
    page = (ROOT / "docs" / "gpu.md").read_text(encoding="utf-8")
    config = config_from_dict(yaml.safe_load(page.partition("```yaml")[2].partition("```")[0]))
    assert (config.device, config.agent.name) == ("cuda", "rsl-ppo")


def test_a_missing_gpu_ends_the_run_before_it_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    config = write_config(tmp_path, "rsl-ppo", 256)
    config.write_text(yaml.safe_dump(yaml.safe_load(config.read_text()) | {"device": "cuda"}))
    assert train(["--config", str(config), "--out", str(tmp_path / "out")]) == 2
    assert "needs an NVIDIA GPU" in one_sentence(capsys)
    assert not (tmp_path / "out").exists()
