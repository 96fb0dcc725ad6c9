"""Keywords that change while an environment runs, and those that do not."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor

import flexarm_env
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.runtime import thread_pool
from flexarm_env.interfaces.env import CHANGEABLE, GUARDED
from tests.refusal import NONSENSE, used_or_refused

ID = "FlexArm/OneLink-Reach-v0"
DRAWN: dict[str, Any] = {"payload_mass": (0.0, 0.0), "stiffness": (1.0, 1.0)}
CHANGES: dict[str, Any] = {
    "reward": {"distance": 2.0, "effort": 0.5},
    "deflection_limit": 0.02,
    "max_episode_steps": 5,
    "randomize": {"payload_mass": (0.02, 0.05), "stiffness": (0.7, 0.8)},
}
FIXED = sorted(GUARDED - {*CHANGEABLE})


def batch(**keywords: Any) -> Any:
    """A batch that draws parameters, with other keywords."""
    return gym.make_vec(ID, num_envs=5, **({"randomize": DRAWN} | keywords))


def single(**keywords: Any) -> Any:
    return gym.make(ID, **({"randomize": DRAWN} | keywords))


def for_sb3(**keywords: Any) -> Any:
    return flexarm_env.SB3VecEnv(ID, 5, **({"randomize": DRAWN} | keywords))


def motion(envs: Any, steps: int = 25) -> list[np.ndarray]:
    """Observations, rewards and ends under hard torques, from the present state."""
    rng = np.random.default_rng(0)
    rows: list[np.ndarray] = []
    for _ in range(steps):
        action = np.sign(rng.uniform(-1.0, 1.0, (5, 1))).astype(np.float32)
        rows += [np.array(x) for x in envs.step(action)[:-1]]
    return rows


def assert_same(first: list[np.ndarray], second: list[np.ndarray]) -> None:
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def numbers(env: Any) -> list[Any]:
    """All that a change may change."""
    core = env.core
    return [core.settings, core.constants.copy(), copy.deepcopy(core.arguments), core.substeps,
            *[w.copy() for w in core.workspaces], *map(np.copy, core.starts)]  # fmt: skip


# ---- what may change -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_batch_is_the_batch_built_so(name: str) -> None:
    """Bit for bit, over restarts; so is its copy, and one that goes through a pickle."""
    built, changed = batch(**{name: CHANGES[name]}), batch()
    plain = batch()
    changed.set_attr(name, CHANGES[name])
    copies = [copy.deepcopy(changed), pickle.loads(pickle.dumps(changed))]
    for envs in (built, changed, plain, *copies):
        envs.reset(seed=0)
    expected = motion(built)
    for envs in (changed, *copies):
        assert getattr(envs, name) == getattr(built, name)
        assert_same(motion(envs), expected)
    with pytest.raises(AssertionError):
        assert_same(motion(plain), expected)


@pytest.mark.parametrize("name", [name for name in CHANGES if name != "max_episode_steps"])
def test_a_changed_single_environment_is_the_one_built_so(name: str) -> None:
    """By the attribute, and through the wrappers of `gymnasium.make`."""
    built, one, other = (single(**{name: CHANGES[name]}), single(), single())
    setattr(one.unwrapped, name, CHANGES[name])
    assert other.set_wrapper_attr(name, CHANGES[name])
    assert name not in vars(other)
    for env in (built, one, other):
        assert env.get_wrapper_attr(name) == CHANGES[name]
        env.reset(seed=0)
    for _ in range(30):
        first, second, third = (env.step(np.ones(1, np.float32)) for env in (built, one, other))
        np.testing.assert_array_equal(first[0], second[0])
        np.testing.assert_array_equal(first[0], third[0])
        assert first[1:4] == second[1:4] == third[1:4]


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_batch_of_stable_baselines_is_the_one_built_so(name: str) -> None:
    """By `set_attr`, by the attribute, through a wrapper, and by `env_method`."""
    ways: list[Callable[[Any, Any], Any]] = [
        lambda envs, value: envs.set_attr(name, value),
        lambda envs, value: envs.set_attr(name, value, indices=range(5)),
        lambda envs, value: setattr(envs, name, value),
        lambda envs, value: VecMonitor(envs).set_attr(name, value),
        lambda envs, value: envs.env_method("set_wrapper_attr", name, value),
    ]
    built = for_sb3(**{name: CHANGES[name]})
    built.seed(0)
    built.reset()
    expected = motion(built)
    for way in ways:
        changed = for_sb3()
        way(changed, CHANGES[name])
        assert changed.get_attr(name, [0, 1]) == 2 * [getattr(built, name)]
        assert changed.env_method("get_wrapper_attr", name, indices=3) == [getattr(built, name)]
        changed.seed(0)
        changed.reset()
        assert_same(motion(changed), expected)


def test_weights_and_limits_hold_from_the_next_step_and_ranges_from_the_next_episode() -> None:
    envs = batch(max_episode_steps=4)
    base = envs.unwrapped
    envs.reset(seed=0)
    rest = np.zeros((5, 1), np.float32)
    envs.step(rest)
    for name in ("reward", "randomize"):
        setattr(base, name, CHANGES[name])
    *_, info = envs.step(rest)
    np.testing.assert_allclose(envs.step(rest)[1], 2.0 * info["reward_terms"]["distance"])
    np.testing.assert_array_equal(base.core.parameters, np.tile([0.0, 1.0], (5, 1)))
    for _ in range(2):
        envs.step(rest)  # the fourth and the restart
    for drawn, (low, high) in zip(
        base.core.parameters.T, CHANGES["randomize"].values(), strict=True
    ):
        assert low <= drawn.min() < drawn.max() <= high
    base.deflection_limit = 1e-6
    rows = base.core.signals.constants.slices
    assert base.core.constants[rows["slope_limit"]] == 1.6e-6
    terminated, info = envs.step(np.ones((5, 1), np.float32))[2::2]
    assert terminated.all()
    assert info["invalid"].all()
    envs.step(rest)
    base.deflection_limit, base.max_episode_steps = 0.5, 1
    assert envs.step(rest)[3].all()


def test_parameters_that_are_left_out_are_those_of_the_hardware_or_nominal() -> None:
    """As for an environment that is built so, but for the parameters that stay free."""
    envs = batch(hardware="laboratory", randomize={"damping": (0.5, 2.0), "stiffness": (2.0, 3.0)})
    base = envs.unwrapped
    spread = gym.make(ID, hardware="laboratory").unwrapped.randomize  # type: ignore[attr-defined]
    for given in (None, {}):
        base.randomize = given
        assert base.randomize == spread | {"damping": (1.0, 1.0)}
    base.randomize = {"payload_mass": (0.0, 0.0)}
    assert base.randomize == {
        "payload_mass": (0.0, 0.0), "stiffness": spread["stiffness"], "damping": (1.0, 1.0),
    }  # fmt: skip
    envs.reset(seed=0)
    drawn = dict(zip(base.randomize, base.core.parameters.T, strict=True))
    assert set(drawn["damping"]) == {1.0}
    assert set(drawn["payload_mass"]) == {0.0}
    assert base.certificate is None
    assert "at resets" in base.uncertified


def test_a_change_reaches_every_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thread_pool, "LEAST_WORK", 1e-9)
    built: Any = gym.make_vec(ID, num_envs=40, threads=2, deflection_limit=0.03)
    changed: Any = gym.make_vec(ID, num_envs=40, threads=2)
    changed.set_attr("deflection_limit", 0.03)
    program = built.core.program
    first, count = int(program.CONSTANTS), int(program.LANES) * built.core.constants.size
    for core in (built.core, changed.core):
        assert len(core.workspaces) == 2
        for w in core.workspaces:
            expected = built.core.workspaces[0][first : first + count]
            np.testing.assert_array_equal(w[first : first + count], expected)


def test_what_is_read_may_be_set_again_and_changes_nothing() -> None:
    for env in (batch().unwrapped, batch(max_episode_steps=-1).unwrapped, single().unwrapped):
        before = [env.core.settings, env.core.constants.copy()]
        for name in env._changeable():
            setattr(env, name, getattr(env, name))
        assert env.core.settings == before[0]
        np.testing.assert_array_equal(env.core.constants, before[1])


@pytest.mark.parametrize("name", ["n_env", "threads", "integrator"])
def test_what_a_core_is_compiled_for_cannot_be_changed_without_effect(name: str) -> None:
    core = batch().unwrapped.core
    with pytest.raises(AttributeError):
        setattr(core, name, getattr(core, name))


def test_a_dict_that_its_owner_changes_later_changes_no_environment() -> None:
    weights, ranges = {"tracking": 1.0}, {"stiffness": (1.0, 2.0)}
    env = single(reward=weights, randomize=ranges).unwrapped
    weights["tracking"], ranges["stiffness"] = 7.0, (5.0, 6.0)
    env.reward["tracking"] = env.randomize["stiffness"] = 9.0
    assert (env.reward, env.randomize) == ({"tracking": 1.0}, {"stiffness": (1.0, 2.0)})
    env.deflection_limit = 0.2
    for each in (env, copy.deepcopy(env)):
        assert (each.reward, each.randomize) == ({"tracking": 1.0}, {"stiffness": (1.0, 2.0)})


def test_a_curriculum_of_stable_baselines_meets_harder_plants() -> None:
    """Wider payloads and a lower limit after every rollout; resets draw from the new range."""
    from stable_baselines3 import PPO

    envs = flexarm_env.SB3VecEnv(
        ID, 16, max_episode_steps=8, randomize={"payload_mass": (0.0, 0.0)}
    )
    stages: list[tuple[float, float]] = []

    class Harder(BaseCallback):
        def _on_rollout_start(self) -> None:
            heaviest = 0.01 * len(stages)
            self.training_env.set_attr("randomize", {"payload_mass": (heaviest, 2.0 * heaviest)})
            self.training_env.set_attr("deflection_limit", 0.1 / (1 + len(stages)))

        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:  # every episode ended within the rollout
            drawn = envs.core.parameters
            stages.append((float(drawn.min()), float(drawn.max())))

    PPO("MlpPolicy", envs, n_steps=16, batch_size=64, n_epochs=1, device="cpu").learn(
        3 * 256, callback=Harder()
    )
    assert stages[0] == (0.0, 0.0)
    assert 0.01 <= stages[1][0] < stages[1][1] <= 0.02 <= stages[2][0] < stages[2][1] <= 0.04
    assert envs.get_attr("deflection_limit", 0) == [0.1 / 3]


# ---- what does not change ------------------------------------------------------------------------


@pytest.mark.parametrize("make", [single, batch, for_sb3])
def test_other_keywords_are_refused_with_the_remedy(make: Any) -> None:
    """By assignment, and by what Gymnasium and stable-baselines3 have in its place."""
    envs = make()
    base = getattr(envs, "unwrapped", envs) if make is not for_sb3 else envs
    ways: list[Any] = [lambda name: setattr(base, name, 0.25)]
    if make is single:
        ways.append(lambda name: envs.set_wrapper_attr(name, 0.25))
        ways.append(lambda name: envs.set_wrapper_attr(name, 0.25, force=False))
    else:
        ways.append(lambda name: envs.set_attr(name, 0.25))
    before, attributes = numbers(base), dict(vars(base))
    names = [*FIXED, "max_episode_steps"] if make is single else FIXED
    for name in names:
        parameter = name in FREE_PARAMETERS
        remedy = rf"randomize={{'{name}': \(0.25, 0.25\)}}" if parameter else rf"{name}=0\.25"
        for way in ways:
            with pytest.raises(ValueError, match=rf"^{name} .*{remedy}"):
                way(name)
    assert vars(base) == attributes
    for a, b in zip(numbers(base), before, strict=True):
        np.testing.assert_equal(a, b)


def test_a_free_parameter_is_set_by_its_range_and_a_new_one_by_a_new_environment() -> None:
    env = single().unwrapped
    with pytest.raises(ValueError, match=r"payload_mass is .*, got 0\.1: set randomize={'payload"):
        env.payload_mass = 0.1
    with pytest.raises(
        ValueError, match=r"friction is .*: build a new environment with randomize="
    ):
        env.friction = 0.1
    with pytest.raises(
        ValueError,
        match=r"\['payload_mass', 'stiffness'\], got \['friction'\] too\. Build a new environment "
        r"with randomize={'friction': \(1\.0, 1\.0\)}",
    ):
        env.randomize = {"friction": (0.5, 1.0), "stiffness": (1.0, 1.0)}
    assert env.randomize == DRAWN


@pytest.mark.parametrize("name", CHANGEABLE)
def test_a_refused_value_changes_nothing(name: str) -> None:
    envs = batch()
    for value in NONSENSE:
        before = numbers(envs)
        refused = True
        with used_or_refused():
            setattr(envs, name, value)
            refused = False
        if refused:
            for a, b in zip(numbers(envs), before, strict=True):
                np.testing.assert_equal(a, b)
        else:
            assert not np.array_equal(envs.core.constants, before[1]) or value in (None, {}, -1)
        assert not envs.core.busy


def test_the_reward_of_goals_stays() -> None:
    env: Any = gym.make("FlexArm/OneLink-ReachGoal-v0").unwrapped
    assert env.reward is None
    with pytest.raises(ValueError, match="must be left out beside obs='goal'"):
        env.reward = "reach"
    env.deflection_limit = 0.2


def test_nothing_changes_while_another_thread_steps() -> None:
    env = single().unwrapped
    env.core.claim()
    with pytest.raises(RuntimeError, match="in use by another thread"):
        env.deflection_limit = 0.2
    env.core.busy = False
    assert env.deflection_limit == 0.1


def test_values_for_some_environments_alone_are_refused() -> None:
    envs, stable = batch(), for_sb3()
    envs.set_attr("deflection_limit", [0.2] * 5)
    assert envs.get_attr("deflection_limit") == (0.2,) * 5
    with pytest.raises(ValueError, match=r"must be the same for all environments, got \[0\.1, 0"):
        envs.set_attr("deflection_limit", [0.1, 0.2, 0.2, 0.2, 0.2])
    with pytest.raises(ValueError, match=r"must have 5 \(one per environment\), got 2"):
        envs.set_attr("deflection_limit", (0.1, 0.1))
    for call in (
        lambda: stable.set_attr("deflection_limit", 0.3, indices=[1, 2]),
        lambda: stable.set_attr("deflection_limit", 0.3, indices=[1, 1, 1, 1, 1]),
        lambda: stable.env_method("set_wrapper_attr", "deflection_limit", 0.3, indices=0),
    ):
        with pytest.raises(ValueError, match="shared by the batch: set it for all environments"):
            call()
    assert stable.deflection_limit == 0.1


# ---- other attributes ----------------------------------------------------------------------------


def test_attributes_of_ones_own_are_free_and_unknown_ones_of_set_attr_are_refused() -> None:
    class Mine(flexarm_env.FlexArmVectorEnv):
        level = 0

    for env in (single().unwrapped, batch().unwrapped):
        env.mark = 1
        assert env.mark == 1
    envs = Mine(2, task="Reach", arm="slim")
    envs.set_attr("level", 3)
    assert envs.get_attr("level") == (3, 3)
    for each in (envs, for_sb3()):
        with pytest.raises(ValueError, match=r"Unknown attribute 'mark'; These may change: \['rew"):
            each.set_attr("mark", 1)
        with pytest.raises(ValueError, match="did you mean 'deflection_limit'"):
            each.set_attr("deflection_limt", 0.2)


def test_the_batch_calls_and_reads_as_gymnasiums_own() -> None:
    """Methods and attributes of each environment, against SyncVectorEnv."""
    keywords: dict[str, Any] = {"num_envs": 3, "render_mode": "rgb_array"}
    ours: Any = gym.make_vec("FlexArm/TwoLink-Reach-v0", **keywords)
    theirs: Any = gym.make_vec("FlexArm/TwoLink-Reach-v0", vectorization_mode="sync", **keywords)
    for envs in (ours, theirs):
        envs.reset(seed=0)
        envs.set_attr("deflection_limit", 0.2)
    for name in ("joint_target", "joint_state", "reach", "torque_limit", "deflection_limit"):
        np.testing.assert_array_equal(ours.get_attr(name), theirs.get_attr(name))
        np.testing.assert_array_equal(ours.call(name), theirs.call(name))
    pictures = ours.call("render")
    assert [picture.shape for picture in pictures] == [p.shape for p in theirs.call("render")]
    for name in ("step", "reset"):
        with pytest.raises(ValueError, match=rf"of the whole batch.*envs\.{name}"):
            ours.call(name)


def test_indices_and_seeds_that_there_are_not_are_refused() -> None:
    envs = flexarm_env.SB3VecEnv(ID, 2)
    for call in (
        lambda: envs.get_attr("reach", 9),
        lambda: envs.env_method("joint_target", indices=9),
    ):
        with pytest.raises(ValueError, match="indices must be below 2, got 9"):
            call()
    with pytest.raises(ValueError, match="seed must be between 0"):
        envs.seed(-1)
    envs.reset()
