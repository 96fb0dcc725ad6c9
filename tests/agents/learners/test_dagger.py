"""Policies distilled from a classical controller, which act without it."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from agents import training
from agents.config import ConfigError, config_from_dict
from agents.controllers import CONTROLLERS, controller
from agents.hybrid.controller import acting, base_of
from agents.hybrid.environment import HybridVecEnv
from agents.hybrid.informed import expert
from agents.leaderboard.shipped import name_of
from agents.learners.dagger import DAgger, misses
from agents.learners.export import export_policy, load_zip
from agents.metrics import make_batch
from agents.policy import load_policy, save_policy
from agents.run_folder.checkpoints import cut_off, restore_checkpoint, save_checkpoint
from agents.run_folder.folder import RunFolder
from agents.training import about_policy, base_description, build_model
from agents.training import main as train
from flexarm_env import SB3VecEnv
from flexarm_env.interfaces.tensors.privileged import Privileged
from tests.agents.tiny import ENV_ID
from tests.agents.toys import check_alike

KWARGS = {"learning_rate": 3e-3, "learning_starts": 400, "batch_size": 128, "train_freq": 50}


def experiment(name: str, steps: int, updates: int = 10, **env: Any) -> dict[str, Any]:
    parameters = CONTROLLERS[name].middle
    return {
        "env": {"id": ENV_ID, "n_envs": 8} | env,
        "agent": {"name": "dagger", "kwargs": KWARGS | {"gradient_steps": updates}},
        "base": {"controller": name, "learned": "distilled", "parameters": parameters},
        "total_steps": steps,
        "evaluation": {"episodes": 3},
    }


@pytest.mark.parametrize("name", ["lqg", "lqr"])
def test_the_expert_advises_what_it_does_alone_if_it_is_followed(name: str) -> None:
    """With filters that must know the torques, or told the state, through ends of episodes."""
    env = {"kwargs": {"hardware": "laboratory", "max_episode_steps": 12}, "n_envs": 3}
    config = config_from_dict(experiment(name, 1_000, **env))
    assert config.base is not None
    batch = SB3VecEnv(ENV_ID, 3, **config.env.kwargs)
    batch.seed(4)
    described = base_description(config.base, config.env)
    advised = HybridVecEnv(batch, base_of(described, batch.envs))
    alone = SB3VecEnv(ENV_ID, 3, **config.env.kwargs)
    alone.seed(4)
    beside = expert(name, alone.envs, described["parameters"])
    ours, theirs, state, starts = advised.reset(), alone.reset(), None, None
    for core in (batch.core, alone.core):
        core.state[core.signals.state.slices["elapsed"], 1] = 5  # it ends before the others
    for _ in range(30):
        np.testing.assert_array_equal(ours, theirs)
        action, state = beside.predict(theirs, state, starts)
        np.testing.assert_allclose(advised.advice, np.clip(action, -1.0, 1.0), atol=1e-6)
        ours = advised.step(advised.advice)[0]
        theirs, _, starts, _ = alone.step(np.clip(action, -1.0, 1.0).astype(np.float32))


def test_a_linear_law_is_learned_on_the_states_that_the_learner_meets() -> None:
    config = config_from_dict(experiment("lqr", 2_400, updates=150))
    model = build_model(config)
    expert = controller("lqr", model.env.envs, CONTROLLERS["lqr"].middle)

    def distance() -> float:
        """RMS distance of actions on episodes of the learner itself."""
        observation, gaps = make_batch(ENV_ID, 8), []
        seen, _ = observation.reset(seed=list(range(8)))
        for _ in range(40):
            own, _ = model.predict(seen, deterministic=True)
            gaps.append(own - np.clip(expert.predict(seen)[0], -1.0, 1.0))
            seen, *_ = observation.step(own)
        return float(np.sqrt(np.mean(np.square(gaps))))

    before = distance()
    model.learn(config.total_steps)
    assert distance() < 0.2 * before
    assert before > 0.3


def test_beyond_a_limit_that_the_expert_reaches_nothing_is_missed() -> None:
    mean = torch.tensor([1.5, 0.5, -1.5, -2.0, 0.3])
    advice = torch.tensor([1.0, 1.0, 1.0, -1.0, 0.1])
    expected = torch.tensor([0.0, -0.5, -2.5, 0.0, 0.2])
    torch.testing.assert_close(misses(mean, advice), expected)


def test_a_distilled_policy_is_stored_without_its_expert(
    tmp_path: Path, unjudged: list[RunFolder]
) -> None:
    """And resumes with what it has seen."""
    path, run = tmp_path / "distilled.yaml", RunFolder(tmp_path / "run")
    given = experiment("lqr", 800, stack=2) | {"checkpoint_seconds": 0.001}
    path.write_text(yaml.safe_dump(given))
    assert train([str(path), "--out", str(run.path)]) == 0
    assert train(["--resume", str(run.path), "--steps", "1600"]) == 0
    policy = load_policy(run.path)
    assert policy.about["expert"]["controller"] == "lqr"
    assert (policy.about["algorithm"], policy.about["steps"]) == ("dagger", 1600)
    assert name_of(policy) == "dagger-of-lqr-stacked"
    envs = make_batch(ENV_ID, 1)
    assert acting(policy, envs) is policy
    state = np.load(sorted(run.checkpoints.iterdir())[-1] / "arrays.npz")
    assert len(state["replay/actions"]) == 1600 / 8


@pytest.mark.parametrize("network", ["MlpPolicy", "MlpLstmPolicy"])
@pytest.mark.parametrize("estimation", [0.0, 0.1])
def test_a_saved_learner_is_loaded_with_what_it_has_learned(
    estimation: float, network: str, tmp_path: Path
) -> None:
    """To go on in an environment, and as a policy without one."""
    given = experiment("lqr", 240)
    kwargs = KWARGS | {"learning_starts": 80, "gradient_steps": 2, "estimation": estimation}
    given["agent"] |= {"policy": network, "kwargs": kwargs}
    model = build_model(config_from_dict(given))
    model.learn(160)
    model.save(tmp_path / "model.zip")
    again = DAgger.load(tmp_path / "model.zip", env=model.env, device="cpu")
    for found in (export_policy(again, {}), load_zip(tmp_path / "model.zip", trust=True)):
        assert found.about["algorithm"] == "dagger"
        for ours, theirs in zip(found.weights, export_policy(model, {}).weights, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    for name, value in model.get_parameters()["policy"].items():
        torch.testing.assert_close(again.get_parameters()["policy"][name], value)
    again.learn(400)
    assert again.num_timesteps >= 400


def test_a_policy_is_compared_with_its_expert_where_the_ranking_has_other_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, run = config_from_dict(experiment("lqr", 800)), RunFolder(tmp_path)
    beside: dict[str, Any] = {}
    model = build_model(config)
    for folder in (run.policy, run.untrained):
        save_policy(export_policy(model, about_policy(config)), folder)
    gains = SimpleNamespace(frequency_ratio=1.0, damping_ratio=1.0)
    monkeypatch.setattr(training, "tune_pd", lambda *given: gains)
    monkeypatch.setattr(
        training, "compare", lambda controllers, *_, **__: beside.update(controllers)
    )
    training.judge(run, config)
    env = make_batch(ENV_ID, 1)
    expert, seen = controller("lqr", env, CONTROLLERS["lqr"].middle), 0.01 * env.reset(seed=[0])[0]
    np.testing.assert_array_equal(beside["lqr"].predict(seen)[0], expert.predict(seen)[0])


def remembering(steps: int, **env: Any) -> dict[str, Any]:
    """An experiment with LSTM cells, whose episodes end at different times."""
    given = experiment("lqg", steps, kwargs={"hardware": "laboratory"} | env, n_envs=3)
    network = {"lstm_hidden_size": 8, "net_arch": [8]}
    given["agent"] |= {"policy": "MlpLstmPolicy"}
    given["agent"]["kwargs"] |= {"learning_starts": 60, "batch_size": 60, "policy_kwargs": network}
    return given


def test_cells_learn_from_whole_episodes_and_remember_them_alone() -> None:
    """The loss sees the means of the stored policy along an episode, also after a resume."""
    model = build_model(config_from_dict(remembering(300, max_episode_steps=30)))
    model.learn(150)
    model.learn(150)
    buffer, episodes = model.replay_buffer, model._episodes()
    env, first, last = episodes.T
    assert sorted(set(last[env == 0])) == [29, 49, 79, 99]
    np.testing.assert_array_equal(first[env == 0], [0, 30, 50, 80])
    held, advice, _ = model._remembered(episodes[[1, 4, 6]])
    policy = export_policy(model, {})
    says, wanted = np.empty((30, 3, 1), np.float32), np.empty((30, 3, 1), np.float32)
    lasting = np.zeros((30, 3), bool)
    for k, (i, begin, end) in enumerate(episodes[[1, 4, 6]]):
        memory = None
        for t, row in enumerate(range(begin, end + 1)):
            lasting[t, k], wanted[t, k] = True, buffer.actions[row, i]
            says[t, k], memory = policy.predict(buffer.observations[row, i], memory)
    assert 0 < lasting.sum() < lasting.size
    np.testing.assert_allclose(model._mean(held).detach().clip(-1, 1), says[lasting], atol=1e-5)
    np.testing.assert_array_equal(advice, wanted[lasting])


@pytest.mark.parametrize("cells", [False, True])
def test_a_network_tells_the_true_state_besides_acting(cells: bool) -> None:
    """The target and the bending, which readings show late and coarse."""
    given = remembering(1_500, max_episode_steps=30)
    given["agent"]["kwargs"] |= {"estimation": 1.0, "gradient_steps": 100}
    if not cells:
        given["agent"] |= {"policy": "MlpPolicy"}
        given["agent"]["kwargs"] |= {"policy_kwargs": {"net_arch": [8]}}
    model = build_model(config_from_dict(given))
    model.learn(1_500)
    lessons = model._of_episodes(model._episodes(), 1_500) if cells else model._of_steps(1_500)
    memory, _, true = lessons
    centre, spread = model._usual_state()
    missed = model.policy.estimator(memory).detach() * spread + centre - true
    parts = Privileged(model.env.envs.core).slices
    shares = missed.square().mean(0) / true.var(0)  # of the variance, 1 of the mean alone
    assert float(shares[parts["target_now"]]) < 0.1
    assert float(shares[parts["modal_amplitude"]][0]) < 0.5
    assert export_policy(model, {}).layer_sizes[-1] == 1


def test_a_true_state_is_stored_beside_its_own_observation() -> None:
    given = remembering(1_200, max_episode_steps=30)
    given["agent"]["kwargs"] |= {"estimation": 1.0, "learning_starts": 300}
    model = build_model(config_from_dict(given))
    model.learn(300)
    told = SB3VecEnv(ENV_ID, 3, privileged=True, **given["env"]["kwargs"])
    told.seed(model.seed)
    seen, buffer = told.reset(), model.replay_buffer
    for row in range(100):
        np.testing.assert_array_equal(seen["observation"], buffer.observations[row])
        np.testing.assert_array_equal(seen["privileged"], buffer.actions[row, :, 1:])
        seen, *_ = told.step(buffer.actions[row, :, :1])


def test_cells_learn_from_the_episodes_that_a_full_buffer_still_has_whole() -> None:
    given = remembering(300, max_episode_steps=30)
    given["agent"]["kwargs"] |= {"buffer_size": 300}
    model = build_model(config_from_dict(given))
    for _ in range(3):
        model.learn(150)
    buffer, episodes = model.replay_buffer, model._episodes()
    assert (buffer.full, buffer.pos) == (True, 50)
    for env, first, last in episodes:
        ends = buffer.dones[(np.arange(first - 1, last) + buffer.pos) % 100, env]
        assert ends[0] == 1.0
        assert not ends[1:].any()
    lengths = episodes[:, 2] - episodes[:, 1] + 1
    assert sorted(lengths.tolist()) == [20] * 6 + [30] * 3
    _, advice, _ = model._remembered(episodes[-1:])
    rows = (np.arange(episodes[-1, 1], episodes[-1, 2] + 1) + buffer.pos) % 100
    np.testing.assert_array_equal(advice, buffer.actions[rows, episodes[-1, 0]])


def test_cells_forget_at_an_end_and_at_a_new_session(monkeypatch: pytest.MonkeyPatch) -> None:
    model = build_model(config_from_dict(remembering(150, max_episode_steps=30)))
    forgot: list[bool] = []
    predict = model.policy.predict
    monkeypatch.setattr(
        model.policy,
        "predict",
        lambda seen, memory, starts, deterministic: (
            forgot.append(bool(starts.all())) or predict(seen, memory, starts, deterministic)
        ),
    )
    model.learn(150)
    model.learn(150)
    assert np.flatnonzero(forgot).tolist() == [0, 30, 50, 80]


@pytest.mark.parametrize(
    ("agent", "learned"), [("dagger", None), ("dagger", "residual"), ("ppo", "distilled")]
)
def test_dagger_and_its_expert_go_together(agent: str, learned: str | None) -> None:
    given = experiment("lqr", 100) | {"agent": {"name": agent}}
    given["base"] = {"controller": "lqr", "learned": learned}
    if learned is None:
        del given["base"]
    with pytest.raises(ConfigError, match=f"go together, got {agent} and"):
        config_from_dict(given)


@pytest.mark.parametrize("estimation", [0.0, 1.0])
def test_a_restored_learner_goes_on_as_the_one_that_was_never_stopped(
    estimation: float, tmp_path: Path
) -> None:
    """Bit for bit, in the episodes that a new session starts; the optimizer remembers too."""
    given = remembering(300, max_episode_steps=30)
    given["agent"]["kwargs"] |= {"estimation": estimation}
    first, second = models = [build_model(config_from_dict(given)) for _ in range(2)]
    first.learn(150)
    restore_checkpoint(second, save_checkpoint(first, tmp_path, {"session": 0, "seconds": 1.0}))
    first.replay_buffer.timeouts = cut_off(first.replay_buffer)  # a stored buffer ends its episodes
    check_alike(models, 150, tmp_path)
