"""Arms that are no presets: models for `modes: auto`, rigid choices, tables of any arm."""

import logging
from pathlib import Path
from typing import Any

import gymnasium as gym
import numba
import pytest

from dynamics import Arm, load_arm
from dynamics.accuracy.choice import NoModel
from flexarm_env.accuracy import certificates
from flexarm_env.accuracy.certificates import AUTO_TOLERANCE, fit
from flexarm_env.accuracy.scene import scene
from flexarm_env.certify import choice

DT = 0.02
OWN: dict[str, Any] = {
    "name": "own",
    "links": [
        {
            "length": 0.8, "rho_A": 0.4, "EIz": 30.0, "tip_mass": 0.1, "damping_ratio": 0.01,
            "joint": {"rotor_inertia": 0.05}, "modes": "auto",
        }
    ],
}  # fmt: skip


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[float]:
    """Tolerances that a choice was asked for; it answers with one mode, or fails for "hard"."""
    tolerances: list[float] = []

    def answer(arm: Arm, control_dt: float, tolerance: float) -> dict[str, Any]:
        tolerances.append(tolerance)
        if arm.name == "hard":
            raise NoModel("No model is within that.")
        link = arm.with_listed_modes().to_dict()["links"][0]
        _, conditions = scene(arm, control_dt)
        return {
            "arm": {"name": arm.name, "links": [{**link, "modes": link["modes"][:1]}]},
            "integrator": "midpoint", "dt": 0.5 * DT, "tolerance": tolerance,
            "error": 0.5 * tolerance, "reason": "One mode suffices.",
            "holds": conditions.to_dict(),
        }  # fmt: skip

    monkeypatch.setattr(choice, "chosen", answer)
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    return tolerances


def test_an_automatic_arm_is_measured_to_a_thousandth_of_its_reach_and_cached(
    searched: list[float], caplog: pytest.LogCaptureFixture
) -> None:
    arm = load_arm(OWN)
    with caplog.at_level(logging.INFO, "flexarm_env"):
        found = [fit(arm, DT, "auto", None) for _ in range(2)]
    assert searched == [AUTO_TOLERANCE * arm.reach]
    assert found[0] == found[1]
    assert len(found[0].arm.links[0].modes) == 1
    assert found[0].entry is not None
    assert found[0].entry["steps"] == [{"integrator": "midpoint", "substeps": 2}]
    assert "modes: auto of own: One mode suffices." in caplog.text


@pytest.mark.parametrize("room", ["accuracy", "certify", "compiled", "hardware", "task"])
def test_what_is_cached_belongs_to_the_sources_that_measured_it(
    room: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Motions, the reference, actuators and torques are among them."""
    monkeypatch.setattr(
        certificates, "hash_of_files", lambda paths: {path.parent for path in paths}
    )
    folder = Path(certificates.__file__).parents[1] / room
    assert folder in certificates._measuring.__wrapped__()


def test_a_tolerance_or_fidelity_replaces_the_choice_of_auto(searched: list[float]) -> None:
    arm = load_arm(OWN)
    fit(arm, DT, "auto", 0.01)
    assert searched == [0.01]
    assert not fit(arm, DT, "rigid", None).arm.links[0].modes
    assert fit(arm.with_listed_modes(), DT, "auto", None).arm == arm
    assert searched == [0.01]


def test_an_automatic_arm_without_a_sufficient_model_keeps_the_rule_and_says_so(
    searched: list[float], caplog: pytest.LogCaptureFixture
) -> None:
    arm = load_arm({**OWN, "name": "hard"})
    found = fit(arm, DT, "auto", None)
    assert found.arm == arm
    assert found.entry is None
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert "No model is within that." in record.getMessage()
    assert "link 1: 2 y" in record.getMessage()


def test_a_failed_tolerance_is_an_error_that_is_not_searched_again(searched: list[float]) -> None:
    arm = load_arm({**OWN, "name": "hard"})
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"No model is within that\."):
            fit(arm, DT, "auto", 0.01)
    assert len(searched) == 1


def test_an_error_that_is_none_of_the_arm_is_not_kept_for_the_next_search(
    searched: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where no further thread can be started, which is a RuntimeError too."""

    def starved(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    arm = load_arm(OWN)
    with monkeypatch.context() as patch:
        patch.setattr(choice, "chosen", starved)
        for tolerance in (None, 0.01):
            with pytest.raises(RuntimeError, match="can't start new thread"):
                fit(arm, DT, "auto", tolerance)
    assert fit(arm, DT, "auto", None).entry is not None


def test_a_search_without_numbas_compiler_is_refused_and_leaves_no_failure_in_the_cache(
    searched: list[float],
) -> None:
    arm = load_arm(OWN)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numba.config, "DISABLE_JIT", 1)
        with pytest.raises(ValueError, match="NUMBA_DISABLE_JIT"):
            fit(arm, DT, "auto", None)
    assert searched == []
    assert fit(arm, DT, "auto", None).entry is not None


def test_the_environment_steps_the_measured_model_and_shows_it(searched: list[float]) -> None:
    env: Any = gym.make("FlexArm/OneLink-Reach-v0", arm=OWN).unwrapped
    assert len(env.arm.links[0].modes) == 1
    assert (env.core.integrator, env.core.substeps) == ("midpoint", 2)
    assert env.certificate["reason"] == "One mode suffices."
    other: Any = gym.make("FlexArm/OneLink-Reach-v0", arm=OWN, integrator="rk4").unwrapped
    assert other.certificate is None


def test_a_drawn_stiffness_does_not_take_the_step_of_the_nominal_arm(
    searched: list[float],
) -> None:
    env: Any = gym.make(
        "FlexArm/OneLink-Reach-v0", arm=OWN, randomize={"stiffness": (0.8, 1.2)}
    ).unwrapped
    assert len(env.arm.links[0].modes) == 1
    assert (env.core.integrator, env.core.substeps) != ("midpoint", 2)
    assert env.certificate is None


def test_a_tolerance_that_ends_in_rigid_links_says_so(caplog: pytest.LogCaptureFixture) -> None:
    arm = load_arm({**OWN, "links": [{**OWN["links"][0], "modes": []}]})
    found = fit(arm, DT, "auto", 0.4)
    assert not found.arm.links[0].modes
    assert found.entry is not None
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert "The chosen model of own has rigid links" in record.getMessage()
    assert f"{found.entry['certificate']['error']:.2g} m" in record.getMessage()


def test_steps_by_rule_suit_the_stiffest_plant_that_may_be_drawn() -> None:
    """They are those of the arm that is described as stiff; a rigid one takes any payload."""
    modes = [{"kind": "clamped-free", "index": k, "direction": "y"} for k in (1, 2)]
    link = {"length": 0.6, "rho_A": 0.3, "EIz": 4.0, "modes": modes,
            "joint": {"rotor_inertia": 0.02}}  # fmt: skip

    def steps(link: dict[str, Any], **drawn: Any) -> tuple[str, int]:
        own = {"arm": {"links": [link, link]}, "control_dt": 0.02}
        core = gym.make("FlexArm/TwoLink-Reach-v0", randomize=drawn, **own).unwrapped.core  # type: ignore[attr-defined]
        return core.integrator, core.substeps

    stiff = steps({**link, "EIz": 36.0})
    assert steps(link) != stiff == steps(link, stiffness=(0.5, 9.0))
    assert steps(link, stiffness=(0.5, 1.0)) == steps(link)
    rigid = {**link, "modes": []}
    assert steps(rigid, payload_mass=(0.0, 0.1)) == steps(rigid)
