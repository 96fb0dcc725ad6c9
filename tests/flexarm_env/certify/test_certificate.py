"""Certificates: each environment has its own, and a default keeps the error that is stated."""

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import flexarm_env
from benchmarks.accuracy.episode_errors import independent, solved
from dynamics import load_arm
from dynamics.model import Model
from dynamics.simulation.step_limits import largest_step
from flexarm_env.accuracy.certificates import entries, reference, stored
from flexarm_env.accuracy.motions import KINDS
from flexarm_env.certify.certificate import FINE, METHOD, WIDER, Certifier, interval
from flexarm_env.certify.episodes import Distances, Episodes, Trace, environment
from flexarm_env.certify.run import conditions
from flexarm_env.certify.search import TIP_ERROR
from flexarm_env.registration import SCENES

SLOW = [pytest.param(scene, marks=pytest.mark.slow) for scene in ("FreeFlyer", "SixLink")]
SCENE_NAMES = ["OneLink", "TwoLink", *SLOW]
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
    if certificate is None:  # beyond the laboratory's certificate
        beyond = {"Agile": "torques above", "Push": "pushes at the tip", "Drop": "is dropped"}
        assert any(x in env_id and words in core.uncertified for x, words in beyond.items())
        return
    assert certificate["integrator"] == core.integrator
    assert certificate["dt"] == pytest.approx(core.control_dt / core.substeps)
    assert certificate["holds"].get("drop", False) == ("Drop" in env_id)
    assert certificate["holds"]["torque_limit"] == core.torque_limit.tolist()
    assert core.uncertified is None
    other = gym.make(env_id, substeps=50, **keywords).unwrapped
    assert other.certificate is None  # type: ignore[attr-defined]


@pytest.mark.parametrize("scene", ["OneLink", "TwoLink", "FreeFlyer"])
def test_arms_of_few_links_keep_a_thousandth_of_the_reach_in_whole_episodes(scene: str) -> None:
    """And a little more at agile torques, and with the payloads of the laboratory."""
    for k, entry in enumerate(stored()[SCENES[scene][0]]["measured"]):
        if entry["certificate"]["holds"].get("drop"):
            continue  # the tip's fast vibration at that moment turns the arm for good
        for kind, found in entry["certificate"]["episodes"]["kinds"].items():
            assert found["share"] <= TIP_ERROR * (1.5 if k else 1.0), kind


def test_six_links_keep_a_thousandth_for_half_a_second() -> None:
    """From rest; where links vibrate from the start, a tenth of that."""
    kinds = stored()["six-link"]["measured"][0]["certificate"]["episodes"]["kinds"]
    for kind, found in kinds.items():
        short = 0.15 if KINDS[kind].shaken else 1.0
        for until, least in zip(found["until"], (0.5, 1.2), strict=True):
            assert until is None or until >= short * least, kind


def test_motions_of_six_links_part_most_where_links_vibrate_from_the_start() -> None:
    """As `docs/certificate.md` says; bang-bang ends before it, as links bend too far."""
    kinds = stored()["six-link"]["measured"][0]["certificate"]["episodes"]["kinds"]
    growth = {kind: found["growth"] for kind, found in kinds.items()}
    most = dict(sorted(growth.items(), key=lambda x: -x[1])[:2])
    assert list(most) == ["shaken", "held"]
    assert most["shaken"] > 200.0
    assert 35.0 < most["held"] < 45.0


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
            wanted = known[key]
            assert again[key] == (wanted and pytest.approx(wanted, rel=0.02)), key


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
    wanted = certifier.error(core.integrator, core.substeps).per_episode

    truth = solved(arm, episodes, core.torque_limit, dt)
    other = Trace(truth, own.valid, own.diverged)
    found = Distances.between(own, other, episodes.kinds).per_episode

    assert found == pytest.approx(wanted, rel=0.2)


def test_shapes_of_both_paths_differ() -> None:
    modes = [mode for link in independent(load_arm("slim")).links for mode in link.modes]
    assert {mode.kind for mode in modes} == {"poly"}


def test_a_reference_sticks_where_its_joint_does() -> None:
    """With fine steps by the frequency alone it creeps by 2e-2 of the reach."""
    link = {
        "length": 0.8, "rho_A": 0.12, "EIz": 6.0, "tip_mass": 0.15, "damping_ratio": 0.01,
        "modes": [{"kind": "clamped-tip-mass", "index": k, "direction": "y"} for k in (1, 2)],
        "joint": {"rotor_inertia": 5e-4, "coulomb": 0.5},
    }  # fmt: skip
    certifier = Certifier(load_arm({"links": [link]}), {"control_dt": 0.01}, 40, None, ["held"], 4)
    finer = certifier._converged(reference(certifier.arm), finer=2)
    found = Distances.between(certifier.reference, finer, certifier.episodes.kinds)
    assert found.worst_share < 1e-5 * certifier.reach


def test_a_reference_has_steps_that_are_stable_in_its_damping() -> None:
    """Its links' segments are damped together, which METHOD takes explicitly."""
    link = {
        "length": 0.6, "rho_A": 0.3, "EIz": 60.0, "tip_mass": 0.4, "damping_ratio": 0.3,
        "segments": 2, "joint": {"rotor_inertia": 1e-3},
        "modes": [{"kind": "hierarchical", "index": k, "direction": "y"} for k in (1, 2)],
    }  # fmt: skip
    certifier = Certifier.__new__(Certifier)
    certifier.control_dt, certifier._fine, certifier._ranges = 0.02, FINE, {}
    arm = load_arm({"links": [link]})
    dt = certifier.control_dt / certifier._fine_steps(arm)
    assert largest_step(Model(arm), np.zeros(arm.n), METHOD, dt) == dt
    assert certifier._fine_steps(load_arm({"links": [{**link, "damping_ratio": 0.0}]})) == FINE


def test_the_largest_deflection_limit_of_an_environment_is_that_of_wider_models_too() -> None:
    certifier = Certifier.__new__(Certifier)
    certifier.arm, certifier.keywords = load_arm("slim"), {"deflection_limit": 1.0}
    assert certifier._core("auto", "rk4", 4, 1, WIDER).settings.deflection_limit == 1.0


def test_episodes_that_all_end_at_once_have_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would be zero."""
    ended = Trace(np.zeros((10, 4, 3)), np.zeros((10, 4), bool), np.zeros(4, bool))
    monkeypatch.setattr(Certifier, "_converged", lambda *_: ended)
    with pytest.raises(ValueError, match="every episode of kind 'held' ends in its first"):
        Certifier(load_arm("slim"), {"control_dt": 0.02}, 10, kinds=("held",), count=4)


def test_what_diverges_in_one_model_alone_has_an_infinite_error() -> None:
    tips, whole = np.zeros((3, 4, 3)), np.ones((3, 4), dtype=bool)
    kinds = tuple(KINDS)[:1] * 4
    calm = Trace(tips, whole, np.zeros(4, dtype=bool))
    lost = Trace(tips, whole.copy(), np.array([False, True, False, False]))
    lost.valid[2, 1] = False
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


def test_stored_certificates_are_numbers() -> None:
    """JSON knows no infinity."""
    json.dumps(stored(), allow_nan=False)


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
        ({"randomize": {"payload_mass": (0.1, 0.1)}}, "payload_mass drawn from 0.1 to 0.1"),
        ({"deflection_limit": 0.3}, "deflections above"),
        ({"deflection_limit": 0.3, "hardware": "laboratory"}, "deflections above"),
        ({"integrator": "rk4"}, "for this integrator and substeps"),
        ({"control_dt": 0.019}, "never measured"),
        ({"fidelity": "rigid"}, "for fidelity='rigid'"),
    ):
        other = gym.make("FlexArm/OneLink-Reach-v0", **keywords).unwrapped  # type: ignore[arg-type]
        assert other.certificate is None, keywords  # type: ignore[attr-defined]
        assert words in other.uncertified  # type: ignore[attr-defined]
        assert "flexarm certify" in other.uncertified  # type: ignore[attr-defined]
