"""Arms that are no presets: models for `modes: auto`, rigid choices, tables of any arm."""

import json
import logging
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

from dynamics import Arm, load_arm
from flexarm_env import certify, pages
from flexarm_env.accuracy import certificates
from flexarm_env.accuracy.certificates import AUTO_TOLERANCE, fit, stored
from flexarm_env.registration import SCENES

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
    """Tolerances that `choose_model` was asked for; it answers with one mode, or fails at 1 m."""
    tolerances: list[float] = []

    class Found:
        def __init__(self, arm: Arm, tolerance: float) -> None:
            link = arm.to_dict()["links"][0]
            self.data = {
                "arm": {"name": arm.name, "links": [{**link, "modes": link["modes"][:1]}]},
                "integrator": "midpoint", "dt": 0.5 * DT, "tolerance": tolerance,
                "error": 0.5 * tolerance, "reason": "One mode suffices.",
            }  # fmt: skip

        def to_dict(self) -> dict[str, Any]:
            return self.data

    def answer(arm: Arm, scene: object, tolerance: float, acceptable: object) -> Found:
        tolerances.append(tolerance)
        if arm.name == "hard":
            raise RuntimeError("No model is within that.")
        return Found(arm, tolerance)

    monkeypatch.setattr(certificates, "choose_model", answer)
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
    assert (found[0].integrator, found[0].substeps) == ("midpoint", 2)
    assert "modes: auto of own: One mode suffices." in caplog.text


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
    assert found.certificate is None
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
    assert env.certificate is None


def test_a_tolerance_that_ends_in_rigid_links_says_so(caplog: pytest.LogCaptureFixture) -> None:
    arm = load_arm({**OWN, "links": [{**OWN["links"][0], "modes": []}]})
    found = fit(arm, DT, "auto", 0.4)
    assert not found.arm.links[0].modes
    assert found.certificate is not None
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert "The chosen model of own has rigid links" in record.getMessage()
    assert f"{found.certificate['error']:.2g} m" in record.getMessage()


# ---- python -m flexarm_env.certify --------------------------------------------------------------


@pytest.fixture
def unmeasured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A copy of certificates.json; every measurement answers with that of slim."""
    known = stored()["slim"]

    class Measured:
        def to_dict(self) -> dict[str, Any]:
            return dict(known["certificate"])

    class Certifies:
        def certificate(self, integrator: str, dt: float) -> Measured:
            return Measured()

    store = tmp_path / "certificates.json"
    store.write_text(certificates.STORE.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(certify, "STORE", store)
    monkeypatch.setattr(
        certify, "fewest_steps",
        lambda certifier, dt, method: next(
            (x for x in known["steps"] if x["integrator"] == method), None
        ),
    )  # fmt: skip
    monkeypatch.setattr(certify, "timed", lambda arm, dt, steps: steps)
    errors = {step["integrator"]: step["episode_error"] for step in known["steps"]}
    monkeypatch.setattr(certify, "episode_error", lambda arm, dt, method, count: errors[method])
    monkeypatch.setattr(certify, "certifier_of", lambda arm, dt: Certifies())
    return store


def test_the_table_of_an_automatic_arm_says_what_was_chosen(
    unmeasured: Path, searched: list[float], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "own.json"
    for name, sentence in (("own", "One mode suffices."), ("hard", "No model was found within")):
        path.write_text(json.dumps({**OWN, "name": name}))
        assert certify.main([str(path)]) == 0
        assert f"Chosen for `modes: auto`: {sentence}" in capsys.readouterr().out


def test_the_printed_table_of_a_registered_arm_is_that_of_its_page(
    unmeasured: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert certify.main(["slim"]) == 0
    table = capsys.readouterr().out.split("\n\n", 1)[1].strip()
    assert "| integration |" in table
    assert table in pages.page("FlexArm/OneLink-Reach-v0")
    assert json.loads(unmeasured.read_text())["slim"] == stored()["slim"]


@pytest.mark.parametrize("source", ["gu-petkov", "own.json", "own.yaml", "slim at 0.01 s"])
def test_any_preset_and_arm_file_is_printed_and_not_stored(
    source: str, unmeasured: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    before = unmeasured.read_bytes()
    given = [source]
    if source.startswith("own"):
        path = tmp_path / source
        path.write_text(json.dumps({**OWN, "links": [{**OWN["links"][0], "modes": []}]}))
        given = [str(path)]
    elif source.startswith("slim"):
        given = ["slim", "--control-dt", "0.01"]
    assert certify.main(given) == 0
    shown = capsys.readouterr()
    assert f"`python -m flexarm_env.certify {given[0]} --control-dt 0.0" in shown.out
    assert "| residual |" in shown.out
    assert "| exponential |" in shown.out
    assert "fewest steps of rk4" in shown.err
    assert unmeasured.read_bytes() == before


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["slimm"], "Unknown arm 'slimm'"),
        (["missing.yaml"], "no such file: missing.yaml in /"),
        (["stanford"], "joint 3 is prismatic"),
        (["slim", "--control-dt", "0"], "--control-dt"),
    ],
)
def test_what_cannot_be_certified_is_one_sentence_and_a_status(
    given: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert certify.main(given) == 2
    shown = capsys.readouterr()
    assert sentence in shown.err
    assert shown.err.count("\n") == 1
    assert shown.out == ""


def test_an_arm_that_no_method_follows_needs_a_shorter_control_step(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(certify, "fewest_steps", lambda *setting: None)
    assert certify.main(["gu-petkov"]) == 2
    assert "give a smaller --control-dt" in capsys.readouterr().err


@pytest.mark.parametrize("name", [arm for arm, _, _ in SCENES.values()])
def test_the_control_step_by_rule_is_near_the_registered_one(name: str) -> None:
    registered = next(dt for arm, dt, _ in SCENES.values() if arm == name)
    assert certify.default_control_dt(load_arm(name)) == registered
