"""Film of a shipped policy."""

from pathlib import Path
from typing import Any

import pytest

from agents.config import load_config
from agents.figures import Film
from agents.metrics import episode_metrics
from benchmarks.output import RESULTS
from benchmarks.training import film_shipped
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

    monkeypatch.setattr("benchmarks.training.write_gif", keep)
    film_shipped(load_config(ROOT / "configs" / "one_link_reach_ppo.yaml"), tmp_path)
    assert seen["path"] == tmp_path / "one_link_reach_ppo.gif"
    assert seen["title"] == "FlexArm/OneLink-Reach-v0"
    for name, latest in (("trained policy", 0.8), ("joint PD", 1.6)):
        (settled,) = episode_metrics(seen[name].recording)["settling_time"]
        assert settled < latest
    with pytest.raises(SystemExit, match=r"No policy of one_link_reach_laboratory_ppo .*--gif"):
        film_shipped(load_config(ROOT / "configs" / "one_link_reach_laboratory_ppo.yaml"), tmp_path)
