"""`flexarm certify`: what it prints, keeps and refuses."""

import json
import math
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import pytest

from dynamics import Arm, load_arm
from flexarm_env.accuracy.certificates import stored
from flexarm_env.accuracy.scene import scene
from flexarm_env.certify import choice
from flexarm_env.certify import run as command
from flexarm_env.certify.search import TIME_PER_DECADE, best_first, given_step
from flexarm_env.pages.environments import page
from flexarm_env.plant import Plant, plan
from flexarm_env.registration import SCENES

OWN: dict[str, Any] = {
    "name": "own",
    "links": [
        {
            "length": 0.8, "rho_A": 0.4, "EIz": 30.0, "tip_mass": 0.1, "damping_ratio": 0.01,
            "modes": [{"kind": "clamped-tip-mass", "index": 1, "direction": "y"}],
            "joint": {"rotor_inertia": 0.05},
        }
    ],
}  # fmt: skip
MOTOR = {
    "type": "dc-motor", "resistance": 2.6, "torque_constant": 0.05, "back_emf": 0.05,
    "voltage_limit": 10.0, "gear": 10.0, "rotor_inertia": 0.0005,
}  # fmt: skip


@pytest.fixture
def unmeasured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[Any, ...]]:
    """Settings that were to be measured; every measurement answers with that of slim."""
    given: list[tuple[Any, ...]] = []

    def entry(*setting: Any) -> dict[str, Any]:
        given.append(setting)
        found: dict[str, Any] = json.loads(json.dumps(stored()["slim"]["measured"][0]))
        return found

    monkeypatch.setattr(command, "entry", entry)
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    return given


def test_the_printed_table_of_an_id_is_that_of_its_page(
    unmeasured: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["FlexArm/OneLink-Reach-v0"]) == 0
    table = capsys.readouterr().out.split("\n\n", 1)[1].strip()
    assert "| integration |" in table
    assert table in page("FlexArm/OneLink-Reach-v0")


def test_keywords_of_an_id_and_of_the_command_are_measured(
    unmeasured: list[tuple[Any, ...]], capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["FlexArm/OneLink-ReachAgile-v0", "--set", "hardware=laboratory"]
    assert command.main([*given, "--set", "deflection_limit=0.05"]) == 0
    _, dt, steps, keywords, _ = unmeasured[-1]
    assert (dt, steps) == SCENES["OneLink"][1:]
    wanted = {"torque_limit": (3.0,), "hardware": "laboratory", "deflection_limit": 0.05}
    assert keywords == wanted
    assert "--set hardware=laboratory" in capsys.readouterr().out


@pytest.mark.parametrize("hardware", ["laboratory", {"preset": "laboratory", "delay": [0, 1]}])
def test_the_printed_command_is_one_for_a_shell(hardware: Any) -> None:
    words = shlex.split(command.command("my arm.yaml", {"hardware": hardware}, 0.02))
    assert words[:-1] == ["flexarm", "certify", "my arm.yaml", "--control-dt", "0.02", "--set"]
    assert command.setting(words[-1]) == ("hardware", hardware)


def test_an_environment_finds_what_the_command_measured(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A real run with few episodes."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(command, "EPISODES", 2)
    monkeypatch.setattr("flexarm_env.certify.search.TIMED", 1)
    path = tmp_path / "own.json"
    path.write_text(json.dumps(OWN))
    keywords: Any = {"arm": str(path), "control_dt": 0.02, "deflection_limit": 0.05}
    before: Any = gym.make("FlexArm/OneLink-Reach-v0", **keywords).unwrapped
    assert "never measured; measure them with `flexarm certify ARM --control-dt 0.02`" in (
        before.uncertified
    )

    step = ["--set", "integrator=exponential-2", "--set", "substeps=1"]
    given = [str(path), "--control-dt", "0.02", "--set", "deflection_limit=0.05"]
    assert command.main([*given, *step]) == 0

    after: Any = gym.make("FlexArm/OneLink-Reach-v0", **keywords).unwrapped
    assert (after.core.integrator, after.core.substeps) == ("exponential-2", 1)
    assert after.certificate["holds"]["deflection_limit"] == 0.05
    assert 0.0 < after.certificate["error"] < 0.05 * after.reach
    wider: Any = gym.make("FlexArm/OneLink-Reach-v0", arm=str(path), control_dt=0.02).unwrapped
    assert wider.certificate is None


@pytest.mark.parametrize(
    ("modes", "keywords"),
    [("auto", {}), ("auto", {"torque_limit": 9.0}), ("auto", {"actuator": MOTOR}),
     (OWN["links"][0]["modes"], {"actuator": MOTOR})],
)  # fmt: skip
def test_certificates_of_models_for_modes_auto_and_of_arms_with_motors_are_found(
    modes: Any, keywords: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "own.json"
    path.write_text(json.dumps({"name": "own", "links": [{**OWN["links"][0], "modes": modes}]}))

    def chosen(arm: Arm, control_dt: float, tolerance: float) -> dict[str, Any]:
        return {
            "arm": arm.with_listed_modes().to_dict(), "integrator": "midpoint", "dt": control_dt,
            "error": tolerance, "tolerance": tolerance, "reason": "Enough.",
            "holds": scene(arm, control_dt)[1].to_dict(),
        }  # fmt: skip

    def planned(tolerance: float | None = None) -> Plant:
        given = {"torque_limit": None, "actuator": None} | keywords
        return plan(arm=str(path), control_dt=0.02, integrator=None, substeps=None, fidelity="auto",
                    tolerance=tolerance, ranges={}, deflection_limit=0.05, **given)  # fmt: skip

    def entry(*_: object) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(json.dumps(stored()["slim"]["measured"][0]))
        dt = 0.02 / found["steps"][0]["substeps"]
        found["certificate"] |= {"dt": dt, "holds": planned().conditions.to_dict()}
        again: dict[str, Any] = json.loads(json.dumps(found))
        return again

    monkeypatch.setattr(choice, "chosen", chosen)
    monkeypatch.setattr(command, "entry", entry)
    options = [
        x for key, value in keywords.items() for x in ("--set", f"{key}={json.dumps(value)}")
    ]
    assert command.main([str(path), "--control-dt", "0.02", *options]) == 0
    assert planned().certificate == entry()["certificate"]
    if not keywords:
        assert planned(0.01).integrator == "midpoint"  # the step of that tolerance


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["slimm"], "Unknown arm 'slimm'"),
        (["missing.yaml"], "missing.yaml: no such file in /"),
        (["stanford"], "joint 3 is prismatic"),
        (["slim", "--control-dt", "0"], "--control-dt"),
        (["FlexArm/OneLnk-Reach-v0"], "did you mean"),
        (["slim", "--set", "hardware=lab"], "lab"),
        (["slim", "--set", "integrator=euler", "--set", "substeps=1"], "diverges"),
        (["--store", "slimm"], "must be one of"),
        (["slim", *["--set", "substeps=1"] * 2], "['substeps'] stand twice in --set"),
        (["slim", "--set", "deflection_limit=much"], "deflection_limit [-] must be a number"),
    ],
)
def test_what_cannot_be_certified_is_one_sentence_and_a_status(
    given: list[str], sentence: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(command, "EPISODES", 2)
    assert command.main(given) == 2
    shown = capsys.readouterr()
    assert sentence in shown.err
    assert len([line for line in shown.err.splitlines() if "certify" in line]) == 1
    assert shown.out == ""


def test_a_given_step_is_not_blamed_for_a_model_that_diverges() -> None:
    lost = SimpleNamespace(worst_share=math.inf)
    certifier: Any = SimpleNamespace(error=lambda *_: lost, model_error=lambda: lost, reach=1.0)
    assert given_step(certifier, "rk4", 4)["error"] == math.inf


@pytest.mark.parametrize("given", ["payload=1", "hardware", "randomize={"])
def test_a_keyword_that_is_none_is_refused_by_the_parser(
    given: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        command.main(["slim", "--set", given])
    assert "--set" in capsys.readouterr().err


def test_certificates_of_ids_are_replaced_by_store_alone(
    unmeasured: list[tuple[Any, ...]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(command, "STORE", tmp_path / "certificates.json")
    with pytest.raises(SystemExit):
        command.main([])
    assert "an ARM is missing" in capsys.readouterr().err
    assert not unmeasured
    assert command.main(["--store", "all"]) == 0
    assert list(json.loads(command.STORE.read_text())) == [arm for arm, _, _ in SCENES.values()]


def test_an_arm_that_no_method_follows_needs_a_shorter_control_step(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "EPISODES", 2)
    monkeypatch.setattr(command, "sufficient_steps", lambda certifier: [])
    assert command.main(["slim"]) == 2
    assert "give a smaller --control-dt" in capsys.readouterr().err


@pytest.mark.parametrize("name", [arm for arm, _, _ in SCENES.values()])
def test_the_control_step_by_rule_is_near_the_registered_one(name: str) -> None:
    registered = next(dt for arm, dt, _ in SCENES.values() if arm == name)
    assert command.default_control_dt(load_arm(name)) == registered


def test_a_tenth_of_the_error_may_cost_a_tenth_more_time() -> None:
    fast = {"seconds": 1.0, "error": 1e-3}
    accurate = {"seconds": 0.99 * math.exp(2.0 * TIME_PER_DECADE), "error": 1e-5}
    slow = {"seconds": 1.01 * math.exp(2.0 * TIME_PER_DECADE), "error": 1e-5}
    assert best_first([slow, fast, accurate]) == [accurate, fast, slow]
    rounded = {"seconds": 0.9, "error": 3e-16}  # of rigid links
    exact = {"seconds": 1.0, "error": 0.0}
    assert best_first([exact, rounded]) == [rounded, exact]
