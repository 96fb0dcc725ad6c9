"""Models chosen over episodes, for `tolerance` and `modes: auto`."""

import logging
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from dynamics import Arm, load_arm
from dynamics.accuracy.choice import NoModel
from dynamics.accuracy.fidelity import everything, rigid
from dynamics.progress import Progress
from flexarm_env.accuracy.certificates import fit
from flexarm_env.accuracy.motions import KINDS, bang_bang, held, recorded, sines, white
from flexarm_env.accuracy.scene import scene
from flexarm_env.certify import choice
from flexarm_env.certify.certificate import Certifier, summary
from flexarm_env.certify.episodes import Distances
from flexarm_env.certify.momentum import momentum_error
from flexarm_env.certify.run import described
from flexarm_env.registration import IDS

ENV_ID = "FlexArm/OneLink-Reach-v0"


def test_a_tolerance_holds_in_whole_episodes() -> None:
    """The short motions of the search alone would allow 25 mm."""
    env: Any = gym.make(ENV_ID, tolerance=0.012).unwrapped
    assert env.certificate["error"] <= 0.012
    assert env.certificate["holds"]["torque_limit"] == env.torque_limit.tolist()
    certifier = Certifier(env.arm, {"control_dt": 0.02}, 150, kinds=("white", "held"), count=40)
    error = certifier.error(env.core.integrator, env.core.substeps).worst_share
    assert 0.3 * env.certificate["error"] < error < 0.012
    env.deflection_limit = 0.3
    assert "deflections above" in env.uncertified
    assert "leave out tolerance and measure them with `flexarm certify`" in env.uncertified


def searching(monkeypatch: pytest.MonkeyPatch, errors: dict[float, float]) -> list[float]:
    """Tolerances of the searches that are made; `errors` in episodes by tolerance, else none."""
    wanted: list[float] = []

    def search(arm: Arm, motions: object, tolerance: float) -> Any:
        wanted.append(round(tolerance, 6))
        if wanted[-1] not in errors:
            raise NoModel("No model is within that.")
        return SimpleNamespace(to_dict=lambda: {"of": wanted[-1]})

    monkeypatch.setattr(choice, "choose_model", search)
    monkeypatch.setattr(choice, "_in_episodes", lambda found, *_: {"error": errors[found["of"]]})
    return wanted


def test_episodes_of_a_search_and_of_own_arms_are_as_long_as_those_of_any_id() -> None:
    """Errors grow in time: of two links eightfold, of one twofold from 150 to 240 steps."""
    longest = max(spec["max_episode_steps"] for spec in IDS.values())
    assert longest <= choice.LENGTH
    _, _, steps, _ = described("korayem-two-link", None, {})
    assert longest <= steps


def test_the_best_of_what_misses_a_tolerance_is_taken_with_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    wanted = searching(monkeypatch, {0.01: 0.05, 0.0016: 0.02})
    found = choice.chosen(load_arm("slim"), 0.02, 0.01)
    assert wanted == [0.01, 0.0016, 0.00064]
    assert (found["error"], found["tolerance"]) == (0.02, 0.01)
    assert "the best keeps 95 % of them within 0.02 m. A smaller tolerance gives" in caplog.text


def test_no_search_follows_that_cannot_come_to_the_tolerance(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Two more searches divide the error by 156 at most."""
    wanted = searching(monkeypatch, {0.01: 1.6})
    assert choice.chosen(load_arm("slim"), 0.02, 0.01)["error"] == 1.6
    assert wanted == [0.01]
    assert "within 1.6 m. Errors grow to the size of the arm in its motions" in caplog.text


def test_what_diverges_in_episodes_is_searched_again_and_refused_at_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wanted = searching(monkeypatch, {0.01: np.inf, 0.0008: np.inf, 0.000064: np.inf})
    with pytest.raises(RuntimeError, match="diverges in whole episodes"):
        choice.chosen(load_arm("slim"), 0.02, 0.01)
    assert wanted == [0.01, 0.0008, 0.000064]


def test_a_link_that_states_no_modes_beside_others_stays_rigid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its stiffness is left to the reference from which the error of the choice is measured."""
    upper = {"length": 0.6, "rho_A": 0.35, "EIz": 18.0, "modes": "auto"}
    stiff = {"length": 0.5, "rho_A": 0.2, "EIz": 6.0}
    arm = load_arm({"links": [upper, {"sections": [stiff], "modes": []}]})

    def search(arm: Arm, motions: object, tolerance: float) -> Any:
        best = replace(rigid(arm, foreshortening=True), counts=everything(arm, 1, 1)).arm(arm)
        return SimpleNamespace(to_dict=lambda: {"arm": best.to_dict(), "reason": "One mode."})

    def measured(found: dict[str, Any], *_: object) -> dict[str, float]:
        return {"error": 0.25 if load_arm(found["arm"]).links[1].stiffnesses else 0.001}

    monkeypatch.setattr(choice, "choose_model", search)
    monkeypatch.setattr(choice, "_in_episodes", measured)
    found = choice.chosen(arm, 0.02, 0.01)
    chosen = load_arm(found["arm"])
    assert chosen.foreshortening
    assert [len(link.modes) for link in chosen.links] == [1, 0]
    assert chosen.links[1] == arm.links[1]
    assert found["error"] == 0.25
    assert found["reference"].startswith("links 1, 2: 2 x")
    assert "within 0.001 m of it, and within 0.25 m of one that bends there." in found["reason"]


@pytest.mark.parametrize(("dt", "fewest"), [(0.005, 4), (0.0051, 4), (0.0049, 5), (0.9, 1)])
def test_steps_in_episodes_are_at_first_the_longest_within_those_of_the_model(
    monkeypatch: pytest.MonkeyPatch, dt: float, fewest: int
) -> None:
    tried: list[int] = []
    model = SimpleNamespace(worst_share=0.0)
    certifier = SimpleNamespace(
        model_error=lambda: model,
        trace=lambda _, substeps, *__: tried.append(substeps),
        reference=None,
        episodes=SimpleNamespace(kinds=("held",)),
    )
    distances = SimpleNamespace(
        between=lambda *_: SimpleNamespace(worst_share=0.03 / tried[-1], kinds=("held",))
    )
    monkeypatch.setattr(choice, "Certifier", lambda *_: certifier)
    monkeypatch.setattr(choice, "Distances", distances)
    monkeypatch.setattr(choice, "summary", lambda *_: {})
    model_of = {"arm": load_arm("slim").to_dict(), "dt": dt, "integrator": "rk4"}
    found = choice._in_episodes(model_of, 0.02, 0.03 / (fewest + 1), Progress(None))
    assert tried == [fewest, fewest + 1, fewest + 1]  # until the tolerance is kept; then nudged
    assert found["dt"] == 0.02 / (fewest + 1)


def test_a_summary_has_the_figures_of_its_episodes() -> None:
    """Of distances [m] that grow; those of "held" are ten times as large."""
    steps, count, reach = 7, 100, 2.0
    growing = np.cumsum(np.random.default_rng(0).uniform(0.0, 1.0, (steps, 2 * count)), axis=0)
    growing[:, count:] *= 10.0
    kinds = ("white",) * count + ("held",) * count
    found = summary(Distances(growing, kinds), Distances(0.1 * growing, kinds), 0.02, reach)
    for kind, last in zip(("white", "held"), np.split(growing[-1], 2), strict=True):
        own = found["kinds"][kind]
        assert (own["worst"], own["median"]) == pytest.approx(
            (last.max() / reach, np.median(last) / reach), rel=1e-2
        )
        assert own["interval"][0] <= own["share"] <= own["interval"][1] <= own["worst"]
        within = np.mean(last <= own["share"] * reach * 1.01)
        assert 0.95 <= within < 0.98
        assert own["share"] == found["curves"][kind][-1]
        assert own["length"] == pytest.approx(steps * 0.02)


@pytest.mark.parametrize(
    ("name", "keywords"),
    [
        ("slim", {}),
        ("free-flyer", {"randomize": {"payload_mass": (0.0, 0.1)}}),
        ("free-flyer", {"base_torque": 0.5}),
    ],
)
def test_no_momentum_is_compared_where_none_is_kept(name: str, keywords: dict[str, Any]) -> None:
    """A fixed base has none, and the model knows none of drawn arms and driven bases."""
    assert momentum_error(load_arm(name), {"control_dt": 0.05, **keywords}, "euler", 1) == 0.0


def test_a_scene_has_the_motions_of_the_certificate() -> None:
    found, conditions = scene(load_arm("two-link"), 0.05)
    assert len(found.motions) == 2
    limits = conditions.torque_limit
    for motion in found.motions:
        assert motion.hold == 0.05
        assert all(abs(t / 0.05 - round(t / 0.05)) < 1e-9 for t in motion.knots)
        assert motion.torque is not None
        torques = np.array([motion.torque(t + 0.01) for t in motion.knots[:-1]])
        assert (np.abs(torques) <= limits).all()
        assert np.abs(torques / limits).max() > 0.5


def test_fidelity_changes_the_model_and_not_the_task() -> None:
    rigid, auto, fine = (
        gym.make(ENV_ID, fidelity=name).unwrapped for name in ("rigid", "auto", "reference")
    )
    assert [env.core.arm.n for env in (rigid, auto, fine)] == [1, 3, 13]  # type: ignore[attr-defined]
    for env in (rigid, fine):
        assert env.torque_limit == auto.torque_limit  # type: ignore[attr-defined]
        assert env.certificate is None  # type: ignore[attr-defined]
    for bad, words in (
        ({"fidelity": "best"}, r"Unknown fidelity 'best'. Known"),
        ({"fidelity": "rigid", "tolerance": 0.1}, "not both"),
        ({"tolerance": -1.0}, "tolerance must be positive"),
    ):
        with pytest.raises(ValueError, match=words):
            gym.make(ENV_ID, **bad)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "keyword",
    [{"randomize": {"payload_mass": (0.0, 0.1)}}, {"hardware": "laboratory"}, {"event": "drop"}],
    ids=lambda keyword: next(iter(keyword)),
)
def test_drawn_parameters_have_no_tolerance(keyword: dict[str, Any]) -> None:
    name = next(iter(keyword))
    words = rf"tolerance \(0.01 m\) covers the arm as described.*{name}.* draw.*ends"
    with pytest.raises(ValueError, match=words):
        gym.make(ENV_ID, **keyword, tolerance=0.01)


def test_a_tolerance_that_nothing_meets_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO), pytest.raises(RuntimeError, match="Take a larger"):
        fit(load_arm("slim"), 0.02, "auto", 1e-7)


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.actions])
def test_actions_of_a_kind_are_within_their_limits_and_differ_between_episodes(name: str) -> None:
    kind = KINDS[name]
    assert kind.actions is not None
    found = kind.actions(np.random.default_rng(0), (100, 6, 2), 0.1)
    assert found.shape == (100, 6, 2)
    assert 0.3 < np.abs(found).max() <= 1.0
    assert (np.std(found[:, :, 0], axis=1).max()) > 0.1


@pytest.mark.parametrize(
    ("name", "count"), [("slim", 2), ("sl", 0), ("", 0), ("/own", 0), ("**", 0)]
)
def test_recordings_are_those_of_an_arm_of_this_very_name(name: str, count: int) -> None:
    assert len(recorded(name, np.array([0.95]))) == count


def test_times_of_the_kinds_are_in_periods() -> None:
    shape = (60, 1, 1)
    rng = np.random.default_rng(0)
    assert len(np.unique(white(rng, shape, 0.1))) == 60
    assert len(np.unique(held(rng, shape, 0.1))) == 4  # 1.5 periods of ten steps
    assert np.abs(bang_bang(rng, shape, 0.1)).min() == 1.0
    assert np.abs(np.diff(sines(rng, shape, 0.01)[:, 0, 0])).max() < 0.11


def test_progress_shows_stages_only_if_asked(capsys: pytest.CaptureFixture[str]) -> None:
    for shown in (None, False, True):
        with Progress(shown) as line:
            line.stage("reference")
            line.motion()
            line.result("0.1 m")
        text = capsys.readouterr().err
        assert ("reference: 1 motions" in text and "0.1 m" in text) == (shown is True)
