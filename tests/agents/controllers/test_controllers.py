"""Every controller of the table on every arm that it takes, and its linear models."""

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from agents.controllers import CONTROLLERS, controller, lqr
from agents.controllers.models.linear_model import LinearModels
from agents.leaderboard.shipped import shipped
from agents.leaderboard.tracks import RANKED, keywords, takes_part
from agents.metrics import episode_metrics, make_batch, record
from agents.tune.controllers import tune
from agents.tuned import parameters_of

IDS = [f"FlexArm/{scene}-Reach-v0" for scene in ("OneLink", "TwoLink")]
SIX = pytest.param("FlexArm/SixLink-Reach-v0", marks=pytest.mark.slow)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("track", ["state", "laboratory"])
@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_every_controller_takes_one_observation_or_a_batch(
    name: str, track: str, env_id: str
) -> None:
    if not takes_part(name, env_id, track):
        pytest.skip("cannot act there")
    envs = make_batch(env_id, 3, keywords(name, track))
    subject = controller(name, envs)
    observations, _ = envs.reset(seed=0)
    state: Any = None
    for _ in range(3):
        actions, state = subject.predict(observations, state, np.zeros(3, bool))
        assert actions.shape == envs.action_space.shape
        assert np.all(np.abs(actions) <= 1.0)
        observations = envs.step(actions.astype(np.float32))[0]
    alone = subject.predict(observations[0])[0]
    assert alone.shape == envs.single_action_space.shape


@pytest.mark.parametrize("failing", [True, False], ids=["balanced", "unbalanced"])
def test_a_riccati_equation_is_solved_where_one_of_both_forms_fails(
    failing: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On some processors SciPy cannot reorder a balanced pencil that others can."""

    def solve(*matrices: Any, balanced: bool) -> Any:
        if balanced is failing:
            raise np.linalg.LinAlgError("Reordering failed")
        return solve_discrete_are(*matrices, balanced=balanced)

    monkeypatch.setattr(lqr, "solve_discrete_are", solve)
    A, B, Q, R = np.array([[1.0, 0.1], [-0.2, 0.9]]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1)
    P = lqr.riccati(A, B, Q, R)
    gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    assert A.T @ P @ (A - B @ gain) + Q == pytest.approx(P)


def test_weights_without_a_gain_are_a_linear_algebra_error() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        lqr.riccati(2.0 * np.eye(1), np.zeros((1, 1)), np.eye(1), np.eye(1))


def _plant(models: LinearModels, *wanted: float) -> int:
    """Index of the plant with a payload and a factor of the stiffness."""
    nearest = [
        int(np.argmin(np.abs(np.array(levels) - value)))
        for levels, value in zip(models.levels, wanted, strict=True)
    ]
    assert [levels[i] for levels, i in zip(models.levels, nearest, strict=True)] == pytest.approx(
        wanted
    )
    return int(np.ravel_multi_index(nearest, [len(levels) for levels in models.levels]))


@pytest.mark.parametrize("loaded", [False, True], ids=["plain", "payload and soft"])
@pytest.mark.parametrize("env_id", [*IDS, SIX])
def test_a_small_motion_follows_the_linear_model(env_id: str, loaded: bool) -> None:
    """The compiled nonlinear step against the matrix exponential."""
    payload = (0.05, 0.15) if loaded else (0.0, 0.0)
    stiffness = (0.9, 1.1) if loaded else (1.0, 1.0)
    models = LinearModels.of(
        make_batch(env_id, 1, {"randomize": {"payload_mass": payload, "stiffness": stiffness}})
    )
    drawn = {"payload_mass": (payload[1], payload[1]), "stiffness": (stiffness[0], stiffness[0])}
    keywords = {"integrator": "rk4", "substeps": 200, "randomize": drawn}
    envs = make_batch(env_id, 1, keywords)
    core: Any = envs.unwrapped.core
    rng = np.random.default_rng(0)
    target = np.array(core.scales.home) + rng.uniform(-0.5, 0.5, core.arm.n_joint)
    model = models.at(target, _plant(models, payload[1], stiffness[0]))
    x = 1e-5 * rng.uniform(-1.0, 1.0, (2, len(model.modes)))
    q, v = x @ model.shapes.T
    q[models.joints] += target
    envs.reset(seed=0, options={"state": {"q": q, "v": v}, "target": target})
    x = x.ravel()
    for _ in range(3):
        action = rng.uniform(-1e-5, 1e-5, (1, core.arm.n_joint)).astype(np.float32)
        _, _, _, _, info = envs.step(action)
        x = model.A @ x + model.B @ (action[0] * core.torque_limit)
    place, speed = core.q[0].copy(), core.v[0]
    place[models.joints] -= target
    found = np.concatenate([model.modes @ place, model.modes @ speed])
    assert np.abs(found - x).max() < 1e-3 * np.abs(x).max()
    if len(model.modes) == core.arm.n:
        readings = model.C @ found
        assert readings[: core.arm.n_joint] == pytest.approx(place[models.joints])
        assert readings[core.arm.n_joint :] == pytest.approx(info["root_curvature"][0], rel=1e-6)
    assert model.tip @ (model.modes @ place) == pytest.approx(
        model.tip_of @ place, abs=0.1 * np.abs(model.tip_of @ place).max()
    )


@pytest.mark.parametrize("env_id", ["FlexArm/OneLink-Damp-v0", "FlexArm/OneLink-Track-v0"])
@pytest.mark.parametrize("name", sorted({*CONTROLLERS} - {"random"}))
def test_an_episode_does_not_depend_on_those_beside_it(name: str, env_id: str) -> None:
    """Nor on those before it: a controller and its solvers begin each one anew."""
    track = "laboratory" if takes_part(name, env_id, "laboratory") else "state"
    if not takes_part(name, env_id, track):
        pytest.skip("cannot act there")
    together, alone = (make_batch(env_id, count, keywords(name, track)) for count in (3, 1))
    others = record(controller(name, together), together, [5, 6, 7])
    subject = controller(name, alone)
    record(subject, alone, [4])
    own = record(subject, alone, [6])
    found = others.tip_error[: len(own.tip_error), 1]
    assert own.tip_error[:, 0] == pytest.approx(found, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("name", ["pd", "pd-zv", "pd-zvd", "pd-ei", "lqr", "lqg"])
def test_tuned_controllers_settle_the_one_link_arm(name: str) -> None:
    envs = make_batch(IDS[0], 16, keywords(name, "state"))
    subject = controller(name, envs, parameters_of(name, IDS[0], "state"))
    metrics = episode_metrics(record(subject, envs, range(16)))
    assert metrics["success"].mean() == 1.0


def test_lqg_settles_late_and_noisy_readings_where_joint_pd_fails() -> None:
    found = {}
    for name in ("lqg", "pd"):
        envs = make_batch(IDS[0], 16, keywords(name, "laboratory"))
        subject = controller(name, envs, parameters_of(name, IDS[0], "laboratory"))
        found[name] = episode_metrics(record(subject, envs, range(16)))["success"].mean()
    assert found["lqg"] >= 0.9
    assert found["pd"] <= 0.5


def test_lqg_believes_the_true_delay() -> None:
    for delay in (0, 1, 2):
        hardware = {"preset": "laboratory", "delay": delay}
        envs = make_batch(IDS[0], 8, {"hardware": hardware})
        design = make_batch(IDS[0], 1, keywords("lqg", "laboratory"))
        subject = controller("lqg", design, parameters_of("lqg", IDS[0], "laboratory"))
        observation, _ = envs.reset(seed=0)
        state: Any = None
        for _ in range(25):
            action, state = subject.predict(observation, state, np.zeros(8, bool))
            observation = envs.step(action.astype(np.float32))[0]
        believed = [subject.observer.hypotheses[k][1] for k in state.surprise.argmin(axis=1)]
        assert np.mean(np.array(believed) == delay) >= 0.9


@pytest.mark.parametrize(
    "env_id", [pytest.param(x, marks=() if "OneLink" in x else pytest.mark.slow) for x in RANKED]
)
def test_reward_thresholds_are_a_little_below_the_mean_return_of_lqr(env_id: str) -> None:
    envs = make_batch(env_id, 100, keywords("lqr", "state"))
    subject = controller("lqr", envs, parameters_of("lqr", env_id, "state"))
    observation, _ = envs.reset(seed=list(range(10_000, 10_100)))
    running, start, returns, state = np.ones(100, bool), np.ones(100, bool), np.zeros(100), None
    while running.any():
        action, state = subject.predict(observation, state, start)
        observation, reward, terminated, truncated, _ = envs.step(action.astype(np.float32))
        returns += np.where(running, reward, 0.0)
        start = terminated | truncated
        running &= ~start
    threshold = gym.spec(env_id).reward_threshold
    assert 0.9 * returns.mean() < threshold < returns.mean()


@pytest.mark.parametrize("name", [name for name, kind in CONTROLLERS.items() if len(kind.obs) == 1])
def test_a_controller_names_itself_and_the_observation_that_it_needs(name: str) -> None:
    (wanted,) = CONTROLLERS[name].obs
    obs = {"state": "sensors", "sensors": "state"}[wanted]
    with pytest.raises(ValueError, match=f"{name} needs obs='{wanted}'"):
        controller(name, make_batch(IDS[0], 1, {"obs": obs}))


def test_names_that_are_in_no_table_are_refused_with_those_that_are() -> None:
    """Of controllers, tracks and ids, from Python as on the command line."""
    envs = make_batch(IDS[0], 1)
    with pytest.raises(ValueError, match="Unknown controller 'lqrr'; did you mean 'lqr'"):
        controller("lqrr", envs)
    with pytest.raises(ValueError, match="Unknown controller 'lqrr'; did you mean 'lqr'"):
        tune("lqrr", IDS[0], {})
    asking: list[Callable[[str, str], Any]] = [partial(parameters_of, "lqr"), shipped]
    for asked in asking:
        with pytest.raises(ValueError, match="Unknown track 'lab'"):
            asked(IDS[0], "lab")
        with pytest.raises(ValueError, match="not an environment of flexarm; did you mean"):
            asked("FlexArm/OneLink-Reech-v0", "state")
        assert asked(f"flexarm_env:{IDS[0]}", "state")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"efort": 1.0}, "Unknown key 'efort' in parameters; nearest known: 'effort'"),
        ({"effort": -1.0}, "parameters.effort must be positive, got -1.0"),
        ({"effort": "1.0"}, "must be a number, got the text '1.0'"),
    ],
)
def test_parameters_that_are_none_of_a_controller_are_refused(
    changes: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        controller("lqr", make_batch(IDS[0], 1), CONTROLLERS["lqr"].middle | changes)


@pytest.mark.parametrize("given", [{}, {"lead": 0.1}])
def test_parameters_that_are_missing_are_named(given: dict[str, float]) -> None:
    left_out = ", ".join(name for name in CONTROLLERS["lqr"].ranges if name not in given)
    with pytest.raises(ValueError, match=rf"parameters lacks {left_out}; give all of \['effort'"):
        controller("lqr", make_batch(IDS[0], 1), given)


def test_what_is_stored_is_not_changed_through_what_is_returned() -> None:
    for asked in (lambda: parameters_of("lqr", IDS[0], "state"), lambda: shipped(IDS[0], "state")):
        asked().clear()
        assert asked()
    next(iter(shipped(IDS[0], "state").values())).clear()
    assert all(shipped(IDS[0], "state").values())
