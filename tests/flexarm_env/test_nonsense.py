"""For any input, an environment gives finite numbers or refuses the input with a sentence."""

import math
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, fields, replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import flexarm_env
from dynamics import ARMS
from flexarm_env.core import Core
from flexarm_env.hardware.actuators import ACTUATORS
from tests.dynamics.test_nonsense import PLAIN, changed, changes
from tests.refusal import NONSENSE, used_or_refused

ONE = "FlexArm/OneLink-Reach-v0"
KEYWORDS = (
    "task", "arm", "obs", "reward", "control_dt", "integrator", "substeps", "torque_limit",
    "deflection_limit", "threads", "dtype", "randomize", "fidelity", "tolerance", "actuator",
    "render_mode",
)  # fmt: skip


def sound(envs: Any, steps: int = 3, **reset: Any) -> None:
    """All numbers of some steps are finite, and divergence terminates; full and random torque."""
    rng = np.random.default_rng(0)
    shape = envs.action_space.shape
    obs, info = envs.reset(**reset)
    given = [obs]
    for k in range(steps):
        action = np.ones(shape) if k % 2 == 0 else rng.uniform(-1.0, 1.0, shape)
        obs, reward, terminated, _, info = envs.step(action.astype(np.float32))
        given += [obs, reward, *(info["reward_terms"][name] for name in flexarm_env.TERMS)]
        given += [x for name, x in info.items() if name != "reward_terms"]
        assert not np.any(info["diverged"] & ~np.asarray(terminated))
        assert obs in envs.observation_space
    assert all(np.isfinite(x).all() for x in given if not isinstance(x, dict))


@pytest.mark.parametrize("name", KEYWORDS)
def test_a_keyword_is_used_or_refused(name: str) -> None:
    for value in NONSENSE:
        with used_or_refused(RuntimeError):
            env = flexarm_env.FlexArmEnv(**({"task": "Reach", "arm": "slim"} | {name: value}))
            sound(env, seed=0)


@pytest.mark.parametrize("name", ["num_envs", "max_episode_steps", "autoreset_mode"])
def test_a_keyword_of_a_batch_is_used_or_refused(name: str) -> None:
    for value in NONSENSE:
        with used_or_refused():
            keywords = {"task": "Reach", "arm": "slim", "num_envs": 2} | {name: value}
            sound(flexarm_env.FlexArmVectorEnv(**keywords), seed=0)


@pytest.fixture(scope="module")
def env() -> Any:
    return gym.make(ONE).unwrapped


@pytest.fixture(scope="module")
def envs() -> Any:
    return gym.make_vec(ONE, num_envs=2)


OPTIONS: dict[str, Callable[[Any], Any]] = {
    "options": lambda x: x,
    "state": lambda x: {"state": x},
    "q": lambda x: {"state": {"q": x}},
    "v": lambda x: {"state": {"v": x}},
    "each v": lambda x: {"state": {"v": [x, 0.0, 0.0]}},
    "target": lambda x: {"target": x},
    "target angle": lambda x: {"target": [x]},
    "other": lambda x: {"other": x},
}


@pytest.mark.parametrize("option", OPTIONS.values(), ids=OPTIONS)
def test_options_are_used_or_refused_and_change_nothing_then(
    option: Callable[[Any], Any], env: Any, envs: Any
) -> None:
    for value in [*NONSENSE, 1e5, [0.0, 1.0, 0.0], [0.0, 1e3, 0.0]]:
        for each in (env, envs):
            each.reset(seed=0)
            before = each.core.state.copy()
            refused = True
            with used_or_refused():
                each.reset(options=option(value))
                refused = False
            if refused:
                np.testing.assert_array_equal(each.core.state, before)
            else:
                sound(each, options=option(value))


def test_seeds_are_used_or_refused(env: Any, envs: Any) -> None:
    for value in [*NONSENSE, [0, None], [1.5, 2], [True, 3], 2**200]:
        for each in (env, envs):
            with used_or_refused():
                sound(each, seed=value)


def test_integers_of_numpy_are_seeds(env: Any, envs: Any) -> None:
    for each, seeds in ((env, (3, np.int64(3), np.uint8(3))), (envs, ([3, 4], np.array([3, 4])))):
        first = each.reset(seed=3)[0].copy()
        for seed in seeds:
            np.testing.assert_array_equal(each.reset(seed=seed)[0], first)


def test_actions_are_used_or_refused_and_change_nothing_then(env: Any, envs: Any) -> None:
    numbers = [math.nan, math.inf, -math.inf, 1e300, -1e38, 5.0]
    one = [[x] for x in numbers]
    two = [[[x], [0.0]] for x in numbers] + [[[0.0], [x]] for x in numbers]
    for each, values in ((env, [*NONSENSE, *one]), (envs, [*NONSENSE, *two])):
        each.reset(seed=0)
        for value in values:
            before = each.core.state.copy()
            refused = True
            with warnings.catch_warnings(), used_or_refused():
                warnings.simplefilter("ignore", RuntimeWarning)  # 1e300 as float32
                each.step(value)
                refused = False
            if refused:
                np.testing.assert_array_equal(each.core.state, before)
            assert np.isfinite(each.core.state).all()


@pytest.mark.parametrize("bad", [math.inf, -math.inf, math.nan])
def test_an_action_that_is_not_finite_is_refused_for_every_size_and_thread(bad: float) -> None:
    env: Any = gym.make(ONE).unwrapped
    env.reset(seed=0)
    before = env.core.state.copy()
    with pytest.raises(ValueError, match="Actions must be finite"):
        env.step(np.array([bad], np.float32))
    np.testing.assert_array_equal(env.core.state, before)
    for keywords in ({"num_envs": 2}, {"num_envs": 20_000, "threads": 2}):
        envs: Any = gym.make_vec(ONE, **keywords)
        envs.reset(seed=0)
        before = envs.unwrapped.core.state.copy()
        actions = np.zeros(envs.action_space.shape, np.float32)
        actions[-1] = bad
        with pytest.raises(ValueError, match=r"Actions must be finite.* for environment \d*[19]\."):
            envs.step(actions)
        np.testing.assert_array_equal(envs.unwrapped.core.state, before)


# ---- large numbers -------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("scene", ["OneLink", "TwoLink", "SixLink"])
def test_rewards_are_finite_whatever_the_torque(scene: str, dtype: str) -> None:
    """From torques that move nothing to torques at which every arm diverges at once."""
    for torque in 10.0 ** np.array([-12, -4, 0, 1, 2, 2.5, 3, 3.25, 3.5, 4, 6, 9, 12]):
        keywords: Any = {"torque_limit": float(torque), "dtype": dtype}
        envs = gym.make_vec(f"FlexArm/{scene}-Reach-v0", num_envs=20, **keywords)
        sound(envs, 12, seed=0)
    with pytest.raises(ValueError, match="torque_limit"):
        gym.make(ONE, torque_limit=1e31)


positive = st.floats(-12.0, 12.0).map(lambda x: 10.0**x)
weights = st.dictionaries(
    st.sampled_from(sorted(flexarm_env.TERMS)), st.floats(-1e12, 1e12), min_size=1
)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    torque_limit=positive,
    control_dt=st.sampled_from([1e-6, 1e-3, 0.02, 0.1, 1.0, 10.0]),
    deflection_limit=st.sampled_from([1e-6, 0.1, 1.0]),
    reward=weights,
    dtype=st.sampled_from(["float64", "float32"]),
    substeps=st.one_of(st.none(), st.integers(1, 50)),
    stiffness=st.tuples(positive, positive),
)
def test_any_keywords_together_give_finite_numbers(**keywords: Any) -> None:
    keywords["randomize"] = {"stiffness": tuple(sorted(keywords.pop("stiffness")))}
    with used_or_refused():
        sound(gym.make_vec(ONE, num_envs=3, **keywords), 6, seed=0)


states = st.lists(st.one_of(st.floats(), st.floats(-1.0, 1.0)), min_size=3, max_size=3)


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(q=states, v=states, target=st.floats())
def test_any_start_is_used_or_refused(q: Any, v: Any, target: float, env: Any) -> None:
    with used_or_refused():
        sound(env, 6, seed=0, options={"state": {"q": q, "v": v}, "target": [target]})


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(plain=st.sampled_from(PLAIN), what=st.lists(changes, min_size=1, max_size=4))
def test_any_arm_is_refused_or_has_finite_scales(plain: dict[str, Any], what: list[Any]) -> None:
    """Torque limit, scales and steps, without compiling, which takes seconds."""
    with used_or_refused(), uncompiled():
        arm = changed(plain, what)
        Core(task="Reach", arm=arm)


@st.composite
def actuators(draw: Any) -> dict[str, Any]:
    """Numbers of any size for the fields of an actuator; optional fields may be left out."""
    kind = draw(st.sampled_from(sorted(ACTUATORS)))
    result: dict[str, Any] = {"type": kind}
    for field in fields(ACTUATORS[kind]):
        if field.default is MISSING or draw(st.booleans()):
            result[field.name] = 10.0 ** draw(st.floats(-28.0, 28.0) | st.floats(-3.0, 3.0))
    return result


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(actuator=actuators(), dtype=st.sampled_from(["float64", "float32"]))
def test_any_actuator_is_refused_or_gives_finite_numbers(actuator: Any, dtype: str) -> None:
    with used_or_refused():
        sound(gym.make_vec(ONE, num_envs=3, actuator=actuator, dtype=dtype), 6, seed=0)


@contextmanager
def uncompiled() -> Iterator[None]:
    """Environments that stop before their code is generated."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Core, "_allocate", lambda core: None)
        yield


def test_an_arm_too_stiff_for_its_control_step_is_refused() -> None:
    slim = ARMS["slim"]
    stiff = replace(slim, links=(replace(slim.links[0], EIz=1e12),))
    with pytest.raises(
        ValueError, match=r"would take \d+ steps .* take fidelity='rigid', .* set sub"
    ):
        gym.make(ONE, arm=stiff)
    with pytest.raises(ValueError, match=r"of 'euler'.*rad/s; give another integrator, leave out"):
        gym.make(ONE, arm=stiff, integrator="euler")
    sound(gym.make(ONE, arm=stiff, fidelity="rigid"), seed=0)
    sound(gym.make(ONE, arm=stiff, substeps=100), seed=0)


@pytest.mark.parametrize(("dtype", "most"), [("float64", 1e8), ("float32", 1e5)])
def test_a_joint_whose_angle_is_too_large_for_a_sine_has_diverged(dtype: str, most: float) -> None:
    """Without modes there is no deflection that would end the episode."""
    envs: Any = gym.make_vec(ONE, num_envs=2, fidelity="rigid", torque_limit=1e8, dtype=dtype)
    sound(envs, 20, seed=0)
    assert np.abs(envs.unwrapped.core.q).max() < most
    envs.reset(seed=0)
    ends = [envs.step(np.ones((2, 1)))[2].all() for _ in range(20)]
    assert any(ends)


@pytest.mark.parametrize("name", ["korayem-two-link", "six-link"])
def test_scales_that_overflow_are_refused(name: str) -> None:
    arm = ARMS[name]
    links = (replace(arm.links[0], length=1e15), *arm.links[1:])
    with pytest.raises(ValueError, match=r"frequencies and scales .* too far apart"):
        gym.make(ONE, arm=replace(arm, links=links))


def test_the_refusal_of_a_large_batch_names_the_limit() -> None:
    with pytest.raises(ValueError, match="num_envs must be between 1 and 1000000, got 10000000000"):
        gym.make_vec(ONE, num_envs=10**10)


# ---- threads -------------------------------------------------------------------------------------


def test_an_environment_in_use_by_another_thread_refuses_to_step() -> None:
    """Single, batch and SB3 environments: stepping and resetting."""
    from flexarm_env import SB3VecEnv

    single: Any = gym.make(ONE).unwrapped
    batch: Any = gym.make_vec(ONE, num_envs=2)
    sb3 = SB3VecEnv(ONE, 2)
    sb3.step_async(np.zeros((2, 1), np.float32))
    for each, step in (
        (single, lambda: single.step(np.zeros(1))),
        (batch, lambda: batch.step(np.zeros((2, 1)))),
        (sb3, sb3.step_wait),
    ):
        each.reset()
        each.core.claim()
        for call in (step, each.reset):
            with pytest.raises(RuntimeError, match="in use by another thread"):
                call()
        each.core.busy = False
        step()


def test_an_interrupted_first_step_leaves_the_environment_usable(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Compiling takes seconds, and a user may stop it."""

    def stopped(*_: Any) -> None:
        raise KeyboardInterrupt

    env: Any = gym.make(ONE).unwrapped
    env.reset(seed=0)
    with monkeypatch.context() as patch:
        patch.setattr("flexarm_env.core.partial", stopped)
        with pytest.raises(KeyboardInterrupt):
            env.step(np.zeros(1))
    env.step(np.zeros(1))


def test_a_single_environment_stepped_from_four_threads_returns_every_step_once() -> None:
    """Every step that is not refused returns its own observation, reward and info."""
    env, alone = (gym.make(ONE).unwrapped for _ in range(2))
    outcomes: list[Any] = []

    def step() -> None:
        for _ in range(500):
            try:
                observation, reward, *_, info = env.step(np.ones(1, np.float32))
                outcomes.append((*observation.tolist(), reward, *info["torque"], info["tip_error"]))
            except RuntimeError:
                time.sleep(0)

    for each in (env, alone):
        each.reset(seed=0)
    often = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=step) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(often)
    expected = []
    for _ in outcomes:
        observation, reward, *_, info = alone.step(np.ones(1, np.float32))
        expected.append((*observation.tolist(), reward, *info["torque"], info["tip_error"]))
    assert len(set(expected)) > 100
    assert sorted(outcomes) == sorted(expected)


def test_a_batch_stepped_from_four_threads_is_right_or_refuses() -> None:
    envs, one = (gym.make_vec(ONE, num_envs=4096) for _ in range(2))
    actions = np.ones((4096, 1), np.float32)
    outcomes: list[str] = []
    ready = threading.Barrier(4)

    def step() -> None:
        ready.wait(10.0)
        for _ in range(10):
            try:
                envs.step(actions)
                outcomes.append("done")
            except RuntimeError as error:
                outcomes.append(str(error).split(";")[0])

    for each in (envs, one):
        each.reset(seed=0)
    threads = [threading.Thread(target=step) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(outcomes) == 40
    assert set(outcomes) <= {"done", "This batch is in use by another thread"}
    for _ in range(outcomes.count("done")):
        one.step(actions)
    np.testing.assert_array_equal(envs.unwrapped.core.state, one.unwrapped.core.state)
