"""Film of a shipped policy, and runs that are kept."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from agents.config import load_config
from agents.controllers.pd import TunedPD
from agents.figures import Film
from agents.metrics import episode_metrics, make_batch
from benchmarks.output import RESULTS
from benchmarks.training.__main__ import faster_pd, film_shipped, main, verdict
from benchmarks.training.runs import run_seed
from tests.agents.tiny import ENV_ID, write_config
from tests.paths import ROOT


def test_the_stored_gif_is_that_of_the_shipped_policy_and_the_stored_gains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both settle in the film as they do in the stored medians, and the title names the id."""
    (tmp_path / "one_link_reach_ppo.json").write_bytes(
        (RESULTS / "one_link_reach_ppo.json").read_bytes()
    )
    seen: dict[str, Any] = {}

    def keep(path: Path, films: dict[str, Film], title: str) -> None:
        seen.update(films, path=path, title=title)

    monkeypatch.setattr("benchmarks.training.__main__.write_gif", keep)
    film_shipped(load_config(ROOT / "configs" / "one_link_reach_ppo.yaml"), tmp_path)
    assert seen["path"] == tmp_path / "one_link_reach_ppo.gif"
    assert seen["title"] == "FlexArm/OneLink-Reach-v0"
    for name, latest in (("trained policy", 0.8), ("joint PD", 1.6)):
        (settled,) = episode_metrics(seen[name].recording)["settling_time"]
        assert settled < latest
    with pytest.raises(SystemExit, match=r"No policy of one_link_reach_tqc .*--gif"):
        film_shipped(load_config(ROOT / "configs" / "one_link_reach_tqc.yaml"), tmp_path)


def test_a_film_shows_the_policy_that_its_own_experiment_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a policy of the same algorithm, on the same track, without the base."""
    name = "one_link_reach_ppo_ahead"
    (tmp_path / f"{name}.json").write_bytes((RESULTS / f"{name}.json").read_bytes())
    seen: list[Any] = []
    monkeypatch.setattr(
        "benchmarks.training.__main__.write_film", lambda config, pair, out: seen.append(pair)
    )
    film_shipped(load_config(ROOT / "configs" / f"{name}.yaml"), tmp_path)
    assert seen[0]["trained policy"].policy.about["config"] == name


def test_a_kept_run_is_not_trained_again(tmp_path: Path) -> None:
    """One of another experiment is refused."""
    config = load_config(write_config(tmp_path, "ppo", 256))
    run, seconds = run_seed(config, tmp_path, 3)
    before = run.rows(), run.policy.joinpath("weights.npz").read_bytes()
    assert run_seed(config, tmp_path, 3) == (run, seconds)
    assert (run.rows(), run.policy.joinpath("weights.npz").read_bytes()) == before
    with pytest.raises(SystemExit, match="seed3 holds a run of another experiment"):
        run_seed(replace(config, total_steps=512), tmp_path, 3)


@pytest.mark.slow
def test_seeds_that_are_added_are_those_of_a_command_with_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before anything is trained, seeds that cannot be added are refused.

    A stored setting that was left out before it existed had its default.
    """
    tuned = TunedPD(frequency_ratio=0.1, damping_ratio=0.7, table=())
    monkeypatch.setattr("benchmarks.training.__main__.tune_pd", lambda *_: tuned)
    config, once, twice = write_config(tmp_path, "ppo", 256), tmp_path / "once", tmp_path / "twice"
    keep = ["--keep", str(tmp_path / "kept")]

    def train(out: Path, *options: str) -> dict[str, Any]:
        main([*keep, "--config", str(config), "--out", str(out), *options])
        found: dict[str, Any] = json.loads((out / f"{config.stem}.json").read_text("utf-8"))
        return found

    with pytest.raises(SystemExit):
        train(twice, "--seeds", "0", "--add")
    assert not any((tmp_path / "kept").iterdir())
    together = train(once, "--seeds", "0", "1")
    first = train(twice, "--seeds", "0")
    del first["config"]["env"]["privileged"]
    (twice / f"{config.stem}.json").write_text(json.dumps(first))
    added = train(twice, "--seeds", "1", "--add")
    assert len(added["runs"]) == 2
    own = {"command": "", "config": {}}
    assert added | own == together | own
    for refused in (("--seeds", "1"), ("--seeds", "2", "--steps", "512")):
        with pytest.raises(SystemExit):
            train(twice, *refused, "--add")


def test_a_faster_joint_pd_has_episodes_as_long_as_the_experiments(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def length(env_id: str, kwargs: Any) -> Any:
        core = make_batch(env_id, 1, kwargs).unwrapped.core
        raise LookupError(core.max_steps * core.control_dt)

    monkeypatch.setattr("benchmarks.training.__main__.tune_pd", length)
    with pytest.raises(LookupError, match=r"^1\.0$"):
        faster_pd(ENV_ID, {"max_episode_steps": 50}, [0])


@pytest.mark.parametrize(
    ("settling", "vibration", "passed"),
    [
        ((0.4, 1.6), (0.0, 0.0), True),  # of a rigid arm
        ((0.4, 1.6), (0.1, 0.0), False),
        ((math.inf, math.inf), (0.0, 0.0), False),
        ((0.0, 0.0), (0.1, 1.0), True),
    ],
)
def test_a_verdict_is_made_where_joint_pd_has_a_median_of_zero(
    settling: tuple[float, float], vibration: tuple[float, float], passed: bool
) -> None:
    policy, pd = (
        {"success_rate": 1.0, "settling_time": s, "residual_vibration": v}
        for s, v in zip(settling, vibration, strict=True)
    )
    assert verdict(policy, pd, following=False)["passed"] is passed
