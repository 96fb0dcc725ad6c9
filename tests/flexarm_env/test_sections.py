"""Environments of an arm whose link is a fishing rod: the model as described and the reference."""

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from agents.controllers.strain import Chords
from dynamics import load_arm
from dynamics.model import Model
from flexarm_env.certify import run as command
from flexarm_env.rendering import Renderer

ROD: dict[str, Any] = {
    "links": [
        {
            "sections": [
                {"length": 0.3, "rho_A": 0.24, "EIz": 24.0},
                {"length": 0.5, "rho_A": [0.12, 0.06], "EIz": [6.0, 1.5]},
            ],
            "tip_mass": 0.05, "damping_ratio": 0.01, "joint": {"rotor_inertia": 0.05},
            "modes": [{"kind": "clamped-tip-mass", "index": k, "direction": "y"} for k in (1, 2)],
        }
    ]
}  # fmt: skip


def made(**keywords: Any) -> Any:
    return gym.make("FlexArm/OneLink-Reach-v0", arm=ROD, control_dt=0.02, **keywords).unwrapped


def test_the_reference_moves_as_the_described_model_and_is_drawn_to_its_tip() -> None:
    tips = []
    for fidelity in ("auto", "reference"):
        env = made(fidelity=fidelity)
        observation, _ = env.reset(seed=0)
        for k in range(40):
            observation, *_ = env.step(np.array([0.3 if k < 20 else -0.3], dtype=np.float32))
        assert np.isfinite(observation).all()
        q = env.core.q[0]
        tips.append(env.core.model.tip(q))
        lines = Renderer(env.core).shapes(env.core, q, 1.0)
        assert lines[-1][-1] == pytest.approx(tips[-1], abs=1e-12)
    assert np.linalg.norm(tips[1] - (0.8, 0.0, 0.0)) > 0.1
    assert np.linalg.norm(tips[0] - tips[1]) < 0.01


def test_a_gauge_of_full_scale_reads_a_deflection_of_a_tenth_by_a_tip_force() -> None:
    """Also as the chord's angle, from which a controller finds the tip."""
    env = made(obs="sensors")
    rod = {
        **ROD["links"][0],
        "modes": [{"kind": "poly", "index": k, "direction": "y"} for k in (1, 2)],
    }
    model = Model(load_arm({"links": [rod]}))
    (body,) = model.chain.links
    bent = np.linalg.solve(np.array(body.K), np.array(body.tip_phi)[:, 1])
    bent *= 0.08 / (bent @ np.array(body.tip_phi)[:, 1])
    curvature = model.strain(np.array([0.0, *bent]), 0, 0.0)[2]
    (part,) = (p for p in env.core.layout.parts if p.name == "root_curvature")
    assert part.scale == pytest.approx((curvature,))
    assert Chords(env, "test").turn[0, 0] * curvature == pytest.approx(0.1)


def test_a_rod_is_certified(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A real run with few episodes."""
    monkeypatch.setenv("FLEXARM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(command, "EPISODES", 2)
    monkeypatch.setattr("flexarm_env.certify.search.TIMED", 1)
    path = tmp_path / "rod.json"
    path.write_text(json.dumps(ROD))
    limit = ["--set", "deflection_limit=0.02"]
    step = ["--set", "integrator=exponential-2", "--set", "substeps=1"]
    assert command.main([str(path), "--control-dt", "0.02", *limit, *step]) == 0
    keywords: Any = {"arm": str(path), "control_dt": 0.02, "deflection_limit": 0.02}
    env: Any = gym.make("FlexArm/OneLink-Reach-v0", **keywords).unwrapped
    assert 0.0 < env.certificate["error"] < 0.02 * env.reach
