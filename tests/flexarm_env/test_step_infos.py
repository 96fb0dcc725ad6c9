"""Infos of `SB3VecEnv`: those of running environments are filled when they are used."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecNormalize

from flexarm_env.interfaces.sb3 import AT_ENDS, RunningInfo, SB3VecEnv, StepInfo

ID = "FlexArm/OneLink-Reach-v0"
GOAL = "FlexArm/OneLink-ReachGoal-v0"
EMPTY: dict[str, Any] = {}


def stepped(n_env: int = 2, steps: int = 1, **keywords: Any) -> list[dict[str, Any]]:
    """Infos after some steps at full torque."""
    envs = SB3VecEnv(ID, n_env, **keywords)
    envs.seed(0)
    envs.reset()
    for _ in range(steps):
        infos = envs.step(np.ones((n_env, 1), np.float32))[3]
    return infos


def plain(info: dict[str, Any]) -> dict[str, Any]:
    """The entries as Python objects, which `==` compares."""
    return {name: x.tolist() if isinstance(x, np.ndarray) else x for name, x in info.items()}


def assert_same_info(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    """Equal keys, types and, to round-off, numbers."""
    assert ours.keys() == theirs.keys()
    for name, value in theirs.items():
        if name == "reward_terms":
            assert_same_info(ours[name], value)
        elif name not in ("episode", "terminal_observation"):
            assert type(ours[name]) is type(value), name
            np.testing.assert_allclose(
                np.asarray(ours[name], float), np.asarray(value, float), rtol=1e-7, atol=1e-9
            )


def test_every_step_has_the_infos_of_monitored_single_environments() -> None:
    """Beside "TimeLimit.truncated", which is at ends alone; so have resets and restarts."""
    ours = SB3VecEnv(ID, 3, max_episode_steps=7)
    theirs = DummyVecEnv([lambda: Monitor(gym.make(ID, max_episode_steps=7))] * 3)
    for envs in (ours, theirs):
        envs.seed(5)
        envs.reset()
    rng = np.random.default_rng(0)
    for step in range(20):
        for a, b in zip(ours.reset_infos, theirs.reset_infos, strict=True):
            assert_same_info(a, b)
        actions = rng.uniform(-1.0, 1.0, (3, 1)).astype(np.float32)
        infos, expected = (envs.step(actions)[3] for envs in (ours, theirs))
        for a, b in zip(infos, expected, strict=True):
            if "terminal_observation" not in b:
                assert b.pop("TimeLimit.truncated") is False
            else:
                b["is_success"] = b["settled"]
            assert isinstance(a, dict)
            assert_same_info(a, b)
        assert ("episode" in infos[0]) == (step in (6, 13))


def test_an_episode_that_fails_on_its_target_is_no_success() -> None:
    """Its log counts it as failed."""
    envs = SB3VecEnv(ID, 1, deflection_limit=1e-4)
    envs.set_options({"state": {"q": [0.0, 0.0, 0.0]}, "target": [0.0]})
    envs.reset()
    _, _, dones, (info,) = envs.step(np.ones((1, 1), np.float32))
    assert dones.all()
    assert info["invalid"]
    assert info["settled"]
    assert info["is_success"] is False


WAYS: dict[str, Callable[[Any], Any]] = {
    "dict": dict,
    "unpacked": lambda info: {**info},
    "copy": lambda info: info.copy(),
    "copy.copy": copy.copy,
    "copy.deepcopy": copy.deepcopy,
    "pickle": lambda info: pickle.loads(pickle.dumps(info)),
    "items": lambda info: dict(info.items()),
    "zip": lambda info: dict(zip(info.keys(), info.values(), strict=True)),
    "iteration": lambda info: {name: info[name] for name in info},
    "reversed": lambda info: {name: info.get(name) for name in reversed(info)},
    "keywords": lambda info: (lambda **entries: entries)(**info),
    "left or": lambda info: info | EMPTY,
    "right or": lambda info: EMPTY | info,
    "update": lambda info: [x := {}, x.update(info)][0],
    "own update": lambda info: [info.update(EMPTY), info][1],
    "in-place or": lambda info: info.__ior__(EMPTY),
    "setdefault": lambda info: [info.setdefault("time", 7.0), info][1],
    "pop": lambda info: {"time": info.pop("time")} | info,
    "popitem": lambda info: info.__class__([info.popitem()]) | info,
    "assignment": lambda info: [info.__setitem__("time", info["time"]), info][1],
    "deletion": lambda info: [x := {"time": info["time"]}, info.__delitem__("time"), x | info][2],
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_every_way_of_reading_an_info_gives_all_of_it(way: Callable[[Any], Any]) -> None:
    info, twin = stepped()[1], stepped()[1]
    assert type(info) is RunningInfo
    expected = {name: twin[name] for name in twin.keys()}  # noqa: SIM118
    assert len(expected) > 10
    assert plain(way(info)) == plain(expected)


def test_questions_to_an_info_are_those_to_a_dict() -> None:
    questions: list[Callable[[Any], Any]] = [
        len, bool, lambda info: "tip_error" in info, lambda info: "nonsense" in info,
        lambda info: info.get("tip_error") > 0.0, lambda info: info.get("nonsense", 3),
        lambda info: [info.clear(), len(info)], lambda info: str(info)[:8],
        lambda info: info == {"time": 0.02}, lambda info: info != {"time": 0.02},
        lambda info: list(info)[:2],
    ]  # fmt: skip
    for question in questions:
        info, twin = stepped()[0], dict(stepped()[0])
        assert question(info) == question(twin)
    with pytest.raises(KeyError, match="nonsense"):
        stepped()[0]["nonsense"]
    match stepped()[0]:
        case {"tip_error": error}:
            assert error > 0.0
        case _:
            raise AssertionError


def test_two_infos_are_equal_if_their_entries_are() -> None:
    """Each side may be unfilled: on both, and on either beside a dict."""

    def info(x: float) -> RunningInfo:
        result = RunningInfo()
        result.source, result.row = lambda row: {"time": x, "reward_terms": {"effort": x}}, 0
        return result

    entries = {"time": 1.0, "reward_terms": {"effort": 1.0}}
    assert info(1.0) == info(1.0)
    assert info(1.0) == entries
    assert entries == info(1.0)
    assert info(1.0) != info(2.0)
    assert info(2.0) | info(1.0) == entries
    assert {"time": 3.0} | info(1.0) == entries
    assert info(1.0) | {"time": 3.0} == {**entries, "time": 3.0}


def test_a_method_that_was_taken_from_an_info_goes_on_with_it() -> None:
    info = stepped()[0]
    get, contains, items = info.get, info.__contains__, info.items
    for _ in range(2):
        assert get("time") == 0.02
        assert contains("time")
        assert len(items()) > 10
    info["episode"] = 1
    assert get("episode") == 1
    assert contains("episode")


def test_learners_ask_for_ends_without_filling_an_info() -> None:
    """Filling takes longer than a step; what is set under these names is found."""
    for info in stepped():
        for name in AT_ENDS:
            assert info.get(name) is None
            assert info.get(name, 3) == 3
            assert name not in info
        assert type(info) is RunningInfo
        info["episode"] = {"r": 1.0}
        assert type(info) is StepInfo
        assert info.get("episode") == {"r": 1.0}
        assert "episode" in info


@pytest.mark.parametrize("n_env", [2, 33])
def test_later_steps_do_not_change_an_info_that_is_kept(n_env: int) -> None:
    """Kept unread over many steps and restarts, or read at once: the same numbers."""
    kept, read = (SB3VecEnv(ID, n_env, max_episode_steps=11) for _ in range(2))
    for envs in (kept, read):
        envs.seed(0)
        envs.reset()
    history: list[Any] = []
    at_once: list[Any] = []
    rng = np.random.default_rng(0)
    for _ in range(40):
        actions = rng.uniform(-1.0, 1.0, (n_env, 1)).astype(np.float32)
        history += kept.step(actions)[3]
        at_once += [copy.deepcopy(dict(info)) for info in read.step(actions)[3]]
    for info, expected in zip(history, at_once, strict=True):
        expected.get("episode", {}).pop("t", None)
        info.get("episode", {}).pop("t", None)
        for entries in (info, expected):
            entries.pop("terminal_observation", None)
        assert plain(info) == plain(expected)


def test_what_a_caller_writes_into_an_info_changes_no_environment() -> None:
    envs = SB3VecEnv(ID, 2)
    envs.reset()
    action = np.ones((2, 1), np.float32)
    first, second = envs.step(action)[3]
    first["torque"][:] = 99.0
    assert second["torque"] < 99.0
    assert envs.step(action)[3][0]["torque"] < 99.0


def test_wrappers_and_buffers_of_stable_baselines_take_the_infos() -> None:
    """Monitor, normalization, stacking; a callback reads the tip error of running environments."""
    errors: list[float] = []

    class Reader(BaseCallback):
        def _on_step(self) -> bool:
            errors.extend(info["tip_error"] for info in self.locals["infos"])
            return True

    envs = VecNormalize(VecFrameStack(VecMonitor(SB3VecEnv(ID, 4, max_episode_steps=5)), 2))
    PPO("MlpPolicy", envs, n_steps=16, batch_size=64, n_epochs=1, device="cpu").learn(
        64, callback=Reader()
    )
    assert len(set(errors)) == 64
    SAC("MlpPolicy", SB3VecEnv(ID, 4, max_episode_steps=5), learning_starts=16, batch_size=16,
        device="cpu").learn(40, callback=Reader())  # fmt: skip
    goals = SAC(
        "MultiInputPolicy", SB3VecEnv(GOAL, 4, max_episode_steps=5), learning_starts=24,
        replay_buffer_class=HerReplayBuffer, replay_buffer_kwargs={"copy_info_dict": True},
        batch_size=16, device="cpu",
    )  # fmt: skip
    goals.learn(40)
    assert goals.replay_buffer is not None
    kept = goals.replay_buffer.infos[:8].ravel()
    assert all(info["time"] > 0.0 for info in kept)
