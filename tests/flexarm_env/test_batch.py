"""The batch, the single environment and `SB3VecEnv` give the same results."""

import math
import pickle
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import ClipReward

import flexarm_env
from dynamics import load_arm
from dynamics.runtime import thread_pool
from flexarm_env.accuracy.certificates import stored

TASKS = ("Reach", "Track", "Damp")
ROUND_OFF = 1e-6  # observations are float32


def random_actions(steps: int, n_env: int, n_joint: int, size: float = 0.5) -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.uniform(-size, size, (steps, n_env, n_joint)).astype(np.float32)


def run(envs: Any, actions: np.ndarray, seed: int = 0) -> list[tuple[Any, ...]]:
    observation, info = envs.reset(seed=seed)
    steps: list[tuple[Any, ...]] = [(observation, info)]
    steps += [envs.step(action[: envs.num_envs]) for action in actions]
    return steps


def assert_same_infos(batch: dict[str, Any], single: dict[str, Any]) -> None:
    """Equal names, and equal values to round-off."""
    assert batch.keys() == single.keys()
    for name, value in single.items():
        if isinstance(value, dict):
            assert_same_infos(batch[name], value)
        else:
            np.testing.assert_allclose(
                np.asarray(batch[name], float), np.asarray(value, float), rtol=1e-7, atol=1e-9
            )


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("scene", ["OneLink", "TwoLink", "SixLink"])
@pytest.mark.parametrize("task", TASKS)
def test_batch_equals_single_environments(scene: str, task: str, mode: str) -> None:
    """Observations, rewards, ends and infos over several episodes, against SyncVectorEnv."""
    env_id = f"FlexArm/{scene}-{task}-v0"
    keywords: dict[str, Any] = {"max_episode_steps": 23}
    batch = gym.make_vec(env_id, num_envs=3, autoreset_mode=mode, **keywords)
    singles = gym.make_vec(
        env_id, num_envs=3, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode},
        **keywords,
    )  # fmt: skip
    actions = np.sign(random_actions(60, 3, batch.unwrapped.n_joint))  # hard enough to fail, too
    failures = 0
    for ours, theirs in zip(run(batch, actions), run(singles, actions), strict=True):
        np.testing.assert_allclose(ours[0], theirs[0], rtol=ROUND_OFF, atol=ROUND_OFF)
        for a, b in zip(ours[1:-1], theirs[1:-1], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
        final, theirs_final = ours[-1].pop("final_obs", None), theirs[-1].pop("final_obs", None)
        assert (final is None) == (theirs_final is None)
        if final is not None:
            for a, b in zip(final, theirs_final, strict=True):
                assert (a is None) == (b is None)
                if a is not None:
                    np.testing.assert_allclose(a, b, rtol=ROUND_OFF, atol=ROUND_OFF)
            ended = ours[-1]["_final_info"]
            ours_info, theirs_info = ours[-1].pop("final_info"), theirs[-1].pop("final_info")
            for name in ("time", "tip_error", "tip_deflection", "torque", "settled"):
                np.testing.assert_allclose(
                    ours_info[name][ended].astype(float),
                    theirs_info[name][ended].astype(float),
                    rtol=1e-7, atol=1e-9,
                )  # fmt: skip
        assert_same_infos(ours[-1], theirs[-1])
        failures += len(ours) > 2 and int(ours[2].sum())
    assert failures > 0 or scene != "OneLink"


@pytest.mark.parametrize("env_id", ["FlexArm/TwoLink-Reach-v0", "FlexArm/OneLink-Track-v0"])
def test_the_caller_restarts_ended_episodes_as_gymnasium_defines_it(env_id: str) -> None:
    """Autoreset mode DISABLED against SyncVectorEnv: only masked environments restart."""
    keywords: dict[str, Any] = {"max_episode_steps": 23}
    disabled = AutoresetMode.DISABLED
    batch = gym.make_vec(env_id, num_envs=3, autoreset_mode=disabled, **keywords)
    singles = gym.make_vec(
        env_id, num_envs=3, vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": disabled}, **keywords,
    )  # fmt: skip
    assert batch.metadata["autoreset_mode"] is disabled
    batch.reset(seed=3)
    singles.reset(seed=3)
    masks = [np.array([False, True, False])] * 2  # while their episodes run
    seeds: list[Any] = [[None, 70, None], None]
    for action in random_actions(60, 3, batch.unwrapped.n_joint):
        ours, theirs = batch.step(action), singles.step(action)
        for a, b in zip(ours[:4], theirs[:4], strict=True):
            np.testing.assert_allclose(a, b, rtol=ROUND_OFF, atol=ROUND_OFF)
        assert_same_infos(ours[4], theirs[4])
        ended = ours[2] | ours[3]
        mask = ended if ended.any() else masks.pop() if masks else None
        if mask is not None:
            seed = seeds.pop() if seeds else None
            started, info = batch.reset(seed=seed, options={"reset_mask": mask})
            expected, other = singles.reset(seed=seed, options={"reset_mask": mask})
            np.testing.assert_allclose(started, expected, rtol=ROUND_OFF, atol=ROUND_OFF)
            np.testing.assert_array_equal(info["_tip_error"], mask)
            assert_same_infos(info, other)
    assert not masks


def test_episodes_that_ended_must_be_restarted_before_a_step() -> None:
    """If the caller restarts them; a refused step or reset changes nothing."""
    envs: Any = gym.make_vec(
        "FlexArm/OneLink-Reach-v0", num_envs=2, autoreset_mode="Disabled", max_episode_steps=4
    )
    with pytest.raises(gym.error.ResetNeeded, match="all environments before some"):
        envs.reset(options={"reset_mask": np.array([True, False])})
    envs.reset(seed=0)
    envs.step(np.zeros((2, 1)))
    envs.reset(options={"reset_mask": np.array([True, False])})
    for _ in range(3):
        observation, _, _, truncated, _ = envs.step(np.ones((2, 1)))
    np.testing.assert_array_equal(truncated, [False, True])
    with pytest.raises(gym.error.ResetNeeded, match=r"environments \[1\] have ended"):
        envs.step(np.zeros((2, 1)))
    for bad in ([True, True], np.zeros(2, bool), np.ones(3, bool), np.ones(2)):
        with pytest.raises(ValueError, match="must be a bool array of shape"):
            envs.reset(options={"reset_mask": bad})
    target = {"target": [0.5], "reset_mask": truncated}
    after, _ = envs.reset(options=target)
    assert set(target) == {"target", "reset_mask"}
    np.testing.assert_array_equal(after[0], observation[0])
    np.testing.assert_array_equal(envs.joint_target()[1], [0.5])
    envs.step(np.zeros((2, 1)))
    others = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=2)
    with pytest.raises(ValueError, match="needs autoreset_mode='Disabled'"):
        others.reset(options={"reset_mask": np.ones(2, bool)})


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize(("n_env", "threads"), [(5, 1), (40, 1), (40, 2), (33, 2)])
def test_results_do_not_depend_on_batch_size_or_threads(
    task: str, n_env: int, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit for bit, over restarts; without the patch one thread would take so few."""
    monkeypatch.setattr(thread_pool, "LEAST_WORK", 1e-9)
    env_id = f"FlexArm/OneLink-{task}-v0"
    actions = random_actions(60, 40, 1)
    reference = gym.make_vec(env_id, num_envs=33, max_episode_steps=25)
    other = gym.make_vec(env_id, num_envs=n_env, threads=threads, max_episode_steps=25)
    assert len(other.unwrapped.core.workspaces) == threads
    common = min(33, n_env)
    for a, b in zip(run(reference, actions), run(other, actions), strict=True):
        for x, y in zip(a[:-1], b[:-1], strict=True):
            np.testing.assert_array_equal(x[:common], y[:common])


def test_a_batch_with_little_work_takes_fewer_threads() -> None:
    few = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=64, threads=2)
    many = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=16384, threads=2)
    assert [len(envs.unwrapped.core.workspaces) for envs in (few, many)] == [1, 2]


@pytest.mark.parametrize("env_id", ["FlexArm/OneLink-Reach-v0", "FlexArm/TwoLink-Track-v0"])
def test_single_precision_is_the_same_environment_to_six_digits(env_id: str) -> None:
    double, single = (gym.make_vec(env_id, num_envs=40, dtype=t) for t in ("float64", "float32"))
    actions = random_actions(40, 40, double.unwrapped.n_joint, size=0.3)
    for a, b in zip(run(double, actions), run(single, actions), strict=True):
        np.testing.assert_allclose(a[0], b[0], atol=2e-4)
        np.testing.assert_allclose(a[-1]["tip_error"], b[-1]["tip_error"], atol=2e-5)


def test_free_parameters_are_drawn_at_every_reset_and_move_the_arm() -> None:
    """Values are in range and new in every episode; a fixed value equals another arm."""
    env_id, ranges = (
        "FlexArm/OneLink-Reach-v0",
        {"payload_mass": (0.01, 0.05), "stiffness": (0.8, 1.2)},
    )
    envs = gym.make_vec(env_id, num_envs=64, max_episode_steps=3, randomize=ranges)
    envs.reset(seed=0)
    first = envs.unwrapped.core.parameters.copy()
    again = gym.make_vec(env_id, num_envs=64, randomize=ranges)
    again.reset(seed=0)
    np.testing.assert_array_equal(first, again.unwrapped.core.parameters)
    for k, (low, high) in enumerate(ranges.values()):
        assert low <= first[:, k].min() < first[:, k].max() <= high
    for _ in range(4):
        envs.step(np.zeros((64, 1)))
    assert (envs.unwrapped.core.parameters != first).all()
    core = gym.make_vec(env_id, num_envs=2).unwrapped.core
    drawn = envs.unwrapped.core
    usual, _, laboratory, *_ = (x["steps"][0] for x in stored()["slim"]["measured"])
    for own, step in ((core, usual), (drawn, laboratory)):  # that of the laboratory is like it
        assert (own.integrator, own.substeps) == (step["integrator"], step["substeps"])

    twice = {"stiffness": (2.0, 2.0), "damping": (2.0**0.5, 2.0**0.5)}  # at the same ratio
    step: Any = {"integrator": "rk4", "substeps": 4}
    fixed = gym.make_vec(env_id, num_envs=2, **step, randomize=twice)
    arm = load_arm("slim")
    stiff = replace(arm, links=(replace(arm.links[0], EIz=2.0 * arm.links[0].EIz),))
    limit = fixed.unwrapped.torque_limit
    keywords: Any = {**step, "arm": stiff, "torque_limit": limit}
    other = gym.make_vec(env_id, num_envs=2, **keywords)
    start = {"state": {"q": [0.0, 0.01, 0.0]}, "target": [0.3]}
    for batch in (fixed, other):
        batch.reset(seed=0, options=start)
    for action in random_actions(20, 2, 1):
        tips = [batch.step(action)[-1]["tip_error"] for batch in (fixed, other)]
        np.testing.assert_allclose(*tips, rtol=1e-12)
    with pytest.raises(ValueError, match=r"Unknown randomize 'mass'. Known"):
        gym.make_vec(env_id, num_envs=2, randomize={"mass": (0.0, 1.0)})
    with pytest.raises(ValueError, match=r"randomize\['stiffness'\] must be \(low, high\)"):
        gym.make_vec(env_id, num_envs=2, randomize={"stiffness": (1.2, 0.8)})


def test_next_step_and_same_step_give_the_same_episodes() -> None:
    """Removing the restart steps from NEXT_STEP leaves SAME_STEP's rewards and final states."""
    same = gym.make_vec(
        "FlexArm/OneLink-Reach-v0", num_envs=2, max_episode_steps=9,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )  # fmt: skip
    following = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=2, max_episode_steps=9)
    actions = random_actions(27, 2, 1)
    one = run(same, actions)
    with_restarts = np.insert(actions, [9, 18], 0.0, axis=0)  # their actions are ignored
    two = run(following, with_restarts)
    np.testing.assert_array_equal([s[1] for s in two[10:11]], [[0.0, 0.0]])
    kept = [s for k, s in enumerate(two[1:]) if k not in (9, 19)]
    np.testing.assert_array_equal([s[1] for s in kept], [s[1] for s in one[1:]])
    np.testing.assert_array_equal(np.stack(one[9][-1]["final_obs"]), two[9][0])
    np.testing.assert_array_equal(one[9][0], two[10][0])


def test_a_list_of_seeds_gives_the_single_environments_with_these_seeds() -> None:
    envs = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=2)
    observation, _ = envs.reset(seed=[7, 3])
    single = gym.make("FlexArm/OneLink-Reach-v0")
    for row, seed in zip(observation, (7, 3), strict=True):
        np.testing.assert_array_equal(row, single.reset(seed=seed)[0])


def test_a_pickled_batch_continues_where_it_was() -> None:
    envs = gym.make_vec("FlexArm/OneLink-Track-v0", num_envs=4, threads=2, max_episode_steps=9)
    actions = random_actions(30, 4, 1)
    run(envs, actions[:9])  # the next step restarts
    copy = pickle.loads(pickle.dumps(envs))
    for action in actions:
        np.testing.assert_array_equal(envs.step(action)[0], copy.step(action)[0])


def test_bad_batch_arguments_are_refused_with_a_sentence() -> None:
    with pytest.raises(ValueError, match="autoreset_mode must be one of"):
        gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=2, autoreset_mode="Never")
    envs = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=2)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"shape \(2, 1\), got \(3, 1\)"):
        envs.step(np.zeros((3, 1)))
    with pytest.raises(ValueError, match=r"got \[nan\] for environment 1"):
        envs.step(np.array([[0.0], [np.nan]]))
    with pytest.raises(ValueError, match=r"seed must hold 2 seeds .*, got 3"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match=r"seed, if it is not an int, must be a list, got 1.5"):
        envs.reset(seed=1.5)


@pytest.mark.parametrize("row", [0, 39])
def test_a_bad_action_steps_no_environment(row: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """For an environment of either thread."""
    monkeypatch.setattr(thread_pool, "LEAST_WORK", 1e-9)
    envs = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=40, threads=2)
    core = envs.unwrapped.core
    assert len(core.workspaces) > 1
    envs.reset(seed=0)
    before = core.state.copy()
    action = np.zeros((40, 1))
    action[row] = np.nan
    with pytest.raises(ValueError, match=rf"got \[nan\] for environment {row}"):
        envs.step(action)
    np.testing.assert_array_equal(core.state, before)


def test_sb3_batch_is_the_same_batch() -> None:
    from stable_baselines3.common.vec_env import DummyVecEnv

    env_id = "FlexArm/OneLink-Reach-v0"
    ours = flexarm_env.SB3VecEnv(env_id, 2, max_episode_steps=9)
    theirs = DummyVecEnv([lambda: gym.make(env_id, max_episode_steps=9)] * 2)
    for envs in (ours, theirs):
        envs.seed(5)
    np.testing.assert_allclose(ours.reset(), theirs.reset(), rtol=ROUND_OFF, atol=ROUND_OFF)
    for action in random_actions(20, 2, 1):
        a, b = ours.step(action), theirs.step(action)
        for x, y in zip(a[:3], b[:3], strict=True):
            np.testing.assert_allclose(x, y, rtol=ROUND_OFF, atol=ROUND_OFF)
        for done, info, other in zip(a[2], a[3], b[3], strict=True):
            assert info["tip_error"] == pytest.approx(other["tip_error"], rel=1e-7)
            assert ("episode" in info) == done
            if done:
                assert info["TimeLimit.truncated"] is other["TimeLimit.truncated"] is True
                assert info["episode"]["l"] == 9
                np.testing.assert_allclose(
                    info["terminal_observation"], other["terminal_observation"],
                    rtol=ROUND_OFF, atol=ROUND_OFF,
                )  # fmt: skip


def test_sb3_options_place_the_episode_of_the_seed_or_change_nothing() -> None:
    env_id, target = "FlexArm/OneLink-Reach-v0", {"target": [0.5]}
    for hardware in (None, "laboratory"):
        envs = flexarm_env.SB3VecEnv(env_id, 2, hardware=hardware)
        singles = [gym.make(env_id, hardware=hardware) for _ in range(2)]
        for given in ([target, {}], [target, target]):
            envs.seed(3)
            envs.set_options(given)
            expected = [
                env.reset(seed=3 + i, options=x)[0]
                for i, (env, x) in enumerate(zip(singles, given, strict=True))
            ]
            np.testing.assert_allclose(envs.reset(), expected, rtol=ROUND_OFF, atol=ROUND_OFF)
        before = envs.core.state.copy(), envs.core.streams.copy()
        envs.set_options([target, {"target": [math.nan]}])
        with pytest.raises(ValueError, match="target"):
            envs.reset()
        np.testing.assert_array_equal(envs.core.state, before[0])
        np.testing.assert_array_equal(envs.core.streams, before[1])


def test_sb3_batch_takes_either_name_of_its_size() -> None:
    for size in ({"n_envs": 3}, {"num_envs": 3}):
        assert flexarm_env.SB3VecEnv("FlexArm/OneLink-Reach-v0", **size).num_envs == 3
    for both in ({}, {"n_envs": 3, "num_envs": 3}):
        with pytest.raises(ValueError, match="once, as n_envs or num_envs, got n_envs="):
            flexarm_env.SB3VecEnv("FlexArm/OneLink-Reach-v0", **both)


def test_sb3_batch_has_the_attributes_and_methods_of_a_vec_env() -> None:
    envs = flexarm_env.SB3VecEnv("FlexArm/TwoLink-Reach-v0", 3)
    envs.reset()
    assert envs.get_attr("task", [0, 2]) == ["Reach", "Reach"]
    targets = envs.env_method("joint_target", indices=[1])
    np.testing.assert_array_equal(targets[0], envs.envs.joint_target()[1])
    assert not envs.has_attr("nonsense")
    assert envs.metadata["render_fps"] == gym.make(envs.envs.spec.id).metadata["render_fps"] == 20
    envs.close()


def test_ppo_and_sac_update_on_the_batch_without_an_error() -> None:
    """One update of each: shapes, infos and bootstrapping fit."""
    from stable_baselines3 import PPO, SAC

    envs = flexarm_env.SB3VecEnv("FlexArm/OneLink-Reach-v0", 8, max_episode_steps=10)
    PPO("MlpPolicy", envs, n_steps=16, batch_size=64, n_epochs=1, device="cpu").learn(128)
    SAC("MlpPolicy", envs, learning_starts=16, batch_size=16, device="cpu").learn(64)


def test_read_only_actions_are_accepted_without_compiling_again() -> None:
    envs: Any = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=3)
    actions = np.array([[0.5], [-0.5], [1.0]], np.float32)
    envs.reset(seed=0)
    expected = envs.step(actions)[0].copy()
    envs.reset(seed=0)
    actions.flags.writeable = False
    np.testing.assert_array_equal(envs.step(actions)[0], expected)
    assert len(envs.core.program.control_step.overloads) == 1


def test_threads_of_a_batch_are_a_count() -> None:
    with pytest.raises(ValueError, match=r"threads must be between 1 and 1024, got 0"):
        gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=2, threads=0)


def test_wrappers_go_round_the_batch_or_round_single_environments() -> None:
    """As the docstring of the batch says, beside what Gymnasium refuses."""
    with pytest.raises(gym.error.Error, match="wrappers"):
        gym.make_vec("FlexArm/OneLink-Reach-v0", 2, wrappers=[flexarm_env.TipTrackingReward])
    whole = ClipReward(gym.make_vec("FlexArm/OneLink-Reach-v0", 2), 0.0, 0.01)
    single: Any = gym.make_vec(
        "FlexArm/OneLink-Reach-v0", 2, vectorization_mode="sync",
        wrappers=[flexarm_env.TipTrackingReward],
    )  # fmt: skip
    for envs in (whole, single):
        envs.reset(seed=0)
        rewards = envs.step(envs.action_space.sample())[1]
        assert rewards.shape == (2,)
    assert "wrappers=[...]" in (flexarm_env.FlexArmVectorEnv.__doc__ or "")
