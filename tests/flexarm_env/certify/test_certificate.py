"""Certificates: each environment has its own, and a default keeps the error that is stated."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from dynamics import Mode, compile_arm, load_arm, simulate
from dynamics.accuracy.fidelity import everything, rigid
from dynamics.simulation.case_file import PiecewiseConstant, Torque
from flexarm_env.accuracy.certificates import entries, stored
from flexarm_env.certify.__main__ import conditions
from flexarm_env.certify.certificate import Certifier, interval
from flexarm_env.certify.episodes import Distances, Episodes, Trace, environment
from flexarm_env.certify.motions import KINDS
from flexarm_env.certify.search import TIP_ERROR
from flexarm_env.registration import SCENES

SIX_LINKS = pytest.param("SixLink", marks=pytest.mark.slow)
SCENE_NAMES = ["OneLink", "TwoLink", "FreeFlyer", SIX_LINKS]
MEASURED = ("error", "integration", "truncation", "nonlinear", "residual")
LONG = 3.0  # of the stated median, which that of few episodes stays within


@pytest.mark.parametrize("env_id", flexarm_env.IDS)
@pytest.mark.parametrize("keywords", [{}, {"hardware": "laboratory"}], ids=["own", "laboratory"])
def test_every_environment_has_the_certificate_of_its_own_step(
    env_id: str, keywords: dict[str, Any]
) -> None:
    if keywords and "Goal" in env_id:
        pytest.skip("goals need exact states")
    core = gym.make(env_id, **keywords).unwrapped.core  # type: ignore[attr-defined]
    certificate = core.certificate
    if certificate is None:  # stronger torques than those of the laboratory's certificate
        assert "Agile" in env_id
        assert "torques above" in core.uncertified
        return
    assert certificate["integrator"] == core.integrator
    assert certificate["dt"] == pytest.approx(core.control_dt / core.substeps)
    assert certificate["holds"]["torque_limit"] == core.torque_limit.tolist()
    assert core.uncertified is None
    other = gym.make(env_id, substeps=50, **keywords).unwrapped
    assert other.certificate is None  # type: ignore[attr-defined]


@pytest.mark.parametrize("scene", ["OneLink", "TwoLink", "FreeFlyer"])
def test_arms_of_few_links_keep_a_thousandth_of_the_reach_in_whole_episodes(scene: str) -> None:
    for entry in stored()[SCENES[scene][0]]["measured"]:
        for kind, found in entry["certificate"]["episodes"]["kinds"].items():
            assert found["share"] <= TIP_ERROR, kind


def test_six_links_keep_a_thousandth_for_half_a_second() -> None:
    kinds = stored()["six-link"]["measured"][0]["certificate"]["episodes"]["kinds"]
    for level, least in enumerate((0.5, 1.2)):
        until = [found["until"][level] for found in kinds.values()]
        kept = [t is None or t >= least for t in until]
        assert sum(kept) >= len(kept) - 1, (level, until)  # bang-bang leaves it earlier


@pytest.mark.parametrize("scene", ["OneLink", "TwoLink"])
def test_a_default_keeps_its_stated_median_in_a_few_episodes(scene: str) -> None:
    """Short form; `test_measuring_again_...` is the whole."""
    name, dt, steps = SCENES[scene]
    kinds = ("white", "held", "bang-bang")
    stated = stored()[name]["measured"][0]["certificate"]["episodes"]["kinds"]
    certifier = Certifier(load_arm(name), {"control_dt": dt}, steps, kinds=kinds, count=8)
    core = environment(load_arm(name), 1, {"control_dt": dt})
    found = certifier.error(core.integrator, core.substeps)
    for kind in kinds:
        own = found.per_episode[np.array(found.kinds) == kind] / certifier.reach
        assert np.median(own) <= LONG * stated[kind]["median"], kind
        assert np.median(own) <= TIP_ERROR, kind


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["OneLink", "TwoLink", "FreeFlyer", "SixLink"])
def test_measuring_again_gives_the_stored_certificate(scene: str) -> None:
    name, dt, steps = SCENES[scene]
    for keywords, kept in zip(conditions(scene), stored()[name]["measured"], strict=True):
        best, known = kept["steps"][0], kept["certificate"]
        certifier = Certifier(load_arm(name), {"control_dt": dt} | keywords, steps)
        again = certifier.certificate(best["integrator"], best["substeps"])
        assert again.keys() == known.keys()
        for key in MEASURED:
            assert again[key] == pytest.approx(known[key], rel=0.02), key


@pytest.mark.parametrize("scene", SCENE_NAMES)
def test_a_second_path_measures_the_same_error(scene: str) -> None:
    """Other segments with powers of x, SciPy's error control, and the compiled environment."""
    name, dt, _ = SCENES[scene]
    arm, steps, count = load_arm(name), 25, 2
    core = environment(arm, count, {"control_dt": dt})
    episodes = Episodes.drawn(core, ("white",), count, steps)
    own = episodes.played(core)
    certifier = Certifier(arm, {"control_dt": dt}, steps, kinds=("white",), count=count)
    assert np.array_equal(certifier.episodes.actions, episodes.actions)
    wanted = certifier.error(core.integrator, core.substeps).largest

    model = compile_arm(independent(arm))
    truth = np.stack(
        [solved(model, episodes, row, core.torque_limit, dt) for row in range(count)], axis=1
    )
    found = Distances.between(own, Trace(truth, own.valid, own.diverged), episodes.kinds).largest

    rows = np.nan_to_num(wanted).max(axis=0)
    assert np.nan_to_num(found).max(axis=0) == pytest.approx(rows, rel=0.2)


def independent(arm: Any) -> Any:
    """The arm in other segments, with powers of x as shapes."""
    segments, modes = (5, 3) if arm.n_joint <= 2 else (3, 2)
    fine = rigid(arm, foreshortening=True, polynomial=True)
    fine = replace(fine, counts=everything(arm, modes, 1), segments=(segments,) * arm.n_joint).arm(
        arm
    )
    links = tuple(
        replace(link, modes=tuple(replace(m, kind="poly") for m in link.modes))
        for link in fine.links
    )
    return replace(fine, links=links)


def solved(model: Any, episodes: Episodes, row: int, limit: Any, dt: float) -> Any:
    """(T, 3) [m] tips of one episode, by SciPy with error control."""
    times = dt * np.arange(len(episodes.actions) + 1)
    actions = episodes.actions[:, row].astype(np.float32).astype(float)
    signals = tuple(
        PiecewiseConstant(times=tuple(times[:-1].tolist()), values=tuple(values.tolist()))
        for values in (actions * limit).T
    )
    q = model.rigid(np.zeros(model.n))
    joints = list(episodes.arm.joint_index)
    q[list(model.arm.joint_index)] = episodes.q[row, joints]
    rest = np.zeros(model.n)
    return simulate(model, q, rest, Torque(signals=signals), times, rtol=1e-8).tip[1:]


def test_modes_of_both_paths_differ() -> None:
    arm = independent(load_arm("slim"))
    assert {type(mode) for link in arm.links for mode in link.modes} == {Mode}
    assert {mode.kind for link in arm.links for mode in link.modes} == {"poly"}


def test_what_diverges_in_one_model_alone_has_an_infinite_error() -> None:
    tips, valid = np.zeros((3, 4, 3)), np.ones((3, 4), dtype=bool)
    kinds = tuple(KINDS)[:1] * 4
    calm = Trace(tips, valid, np.zeros(4, dtype=bool))
    lost = Trace(tips, valid, np.array([False, True, False, False]))
    found = Distances.between(calm, lost, kinds)
    assert np.isinf(found.per_episode).tolist() == [False, True, False, False]
    assert found.worst_share == np.inf


def test_an_interval_of_a_quantile_covers_it_as_often_as_it_says() -> None:
    rng, hits = np.random.default_rng(0), 0
    truth = -np.log(0.05)  # the 95 % of an exponential distribution
    for _ in range(400):
        low, high = interval(rng.exponential(size=64), 0.95)
        hits += low <= truth <= high
    assert hits / 400 > 0.9


def test_an_entry_covers_what_it_measured_and_less() -> None:
    arm, dt, _ = SCENES["OneLink"]
    measured = entries(load_arm(arm), dt)
    assert len(measured) >= 3
    weaker = gym.make("FlexArm/OneLink-Reach-v0", torque_limit=0.5).unwrapped
    usual = gym.make("FlexArm/OneLink-Reach-v0").unwrapped
    assert weaker.certificate == usual.certificate  # type: ignore[attr-defined]
    for keywords, words in (
        ({"torque_limit": 9.0}, "torques above"),
        ({"actuator": {"type": "limited"}}, "these actuators"),
        ({"randomize": {"payload_mass": (0.0, 9.0)}}, "payload_mass drawn from 0 to 9"),
        ({"deflection_limit": 0.3}, "deflections above"),
        ({"integrator": "rk4"}, "for this integrator and substeps"),
        ({"control_dt": 0.019}, "never measured"),
    ):
        other = gym.make("FlexArm/OneLink-Reach-v0", **keywords).unwrapped  # type: ignore[arg-type]
        assert other.certificate is None, keywords  # type: ignore[attr-defined]
        assert words in other.uncertified  # type: ignore[attr-defined]
        assert "flexarm certify" in other.uncertified  # type: ignore[attr-defined]
