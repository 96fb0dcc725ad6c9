"""Registered environments give the results that are stored in tests/reference/digests.json.

    python -m tests.flexarm_env.test_digests ID ...   # store new results of the ids meant to change

Results are equal bit for bit on the processors and compilers whose digests are stored. Others
contract multiply-adds differently; there, results are equal to nine digits.
"""

import hashlib
import json
import sys
from collections.abc import Collection
from functools import partial
from typing import Any

import gymnasium as gym
import numba
import numpy as np
import pytest
from llvmlite import binding

import flexarm_env
from tests.paths import REFERENCE

STORE = REFERENCE / "digests.json"
KINDS: dict[str, dict[str, Any]] = {
    "default": {},
    "sensors in float32": {"obs": "sensors", "dtype": "float32"},
    "drawn parameters": {"randomize": {"payload_mass": (0.0, 0.1), "stiffness": (0.8, 1.2)}},
    "laboratory": {"hardware": "laboratory", "obs": "sensors"},
}
EVERYWHERE = ("default", "laboratory")
STEPS, BATCH = 60, 20
TAKEN = {  # steps per control step, which measuring on another machine must not change
    "OneLink": {"default": ("exponential-3", 1), "laboratory": ("exponential-4", 2)},
    "TwoLink": dict.fromkeys(("default", "laboratory"), ("numerov", 2)),
    "SixLink": {
        "default": ("extrapolated-midpoint", 12),
        "laboratory": ("extrapolated-midpoint", 13),
    },
    "OneLink-ReachAgile": {"default": ("exponential-4", 1), "laboratory": ("exponential-4", 2)},
    "TwoLink-ReachAgile": {"default": ("numerov", 3), "laboratory": ("numerov", 2)},
    "OneLink-TrackDrop": dict.fromkeys(("default", "laboratory"), ("exponential-4", 2)),
    "FreeFlyer": {"default": ("numerov", 6), "laboratory": ("extrapolated-midpoint", 7)},
}
STARTS = {"settled": 0.0, "broken": 0.25}  # deflection of the first link over its length


def processor() -> str:
    """Processor that code is compiled for, and compiler."""
    return f"{binding.get_host_cpu_name()}, numba {numba.__version__}"


def numbers_of(obs: Any) -> list[Any]:
    """Arrays of an observation, which may be a dict."""
    return list(obs.values()) if isinstance(obs, dict) else [obs]


def followed(env: Any, batch: bool) -> tuple[str, list[float]]:
    """Digest of the results of some steps of random torque, and a few of the numbers."""
    digest, rng = hashlib.sha256(), np.random.default_rng(0)
    obs, _ = env.reset(seed=7)
    given = numbers_of(obs)
    for _ in range(STEPS):
        action = rng.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
        obs, reward, terminated, truncated, info = env.step(action)
        given += [*numbers_of(obs), reward, terminated, truncated]
        given += [
            info[name] for name in ("tip_error", "tip_deflection", "root_curvature", "torque")
        ]
        if not batch and (terminated or truncated):
            given += numbers_of(env.reset()[0])
    for x in given:
        digest.update(np.ascontiguousarray(x).tobytes())
    few = [np.sum(reward), np.sum(info["tip_error"]), np.sum(info["tip_deflection"])]
    return digest.hexdigest(), [float(x) for x in few]


def judged(env_id: str, bent: float) -> tuple[str, list[float]]:
    """Digest of a step without torque from rest on the target, the first link bent.

    It pins what random torque hardly reaches: the reward of a goal, and the price of a failure.
    Numbers are the reward, whether the episode failed, and the steps of an episode.
    """
    env: Any = gym.make(env_id)
    core = env.unwrapped.core
    q, base = np.zeros(core.model.n), core.arm.base.n
    joints = list(core.arm.joint_index)
    q[joints] = core.scales.home
    mode = next(i for i in range(base, q.size) if i not in joints)
    placed = {"state": {"q": q}} | ({} if core.task.moving else {"target": core.scales.home})
    if bent:
        q[mode] = 1e-3
        q[mode] *= bent / np.max(env.reset(seed=7, options=placed)[1]["deflection"])
    given = numbers_of(env.reset(seed=7, options=placed)[0])
    obs, reward, terminated, _, _ = env.step(np.zeros(env.action_space.shape, np.float32))
    given += [*numbers_of(obs), reward, terminated]
    if core.layout.goal:
        apart = np.zeros((81, core.layout.goal))
        apart[:, 0] = np.linspace(0.0, 0.04, 81)
        given.append(env.unwrapped.compute_reward(apart, np.zeros_like(apart), {}))
    digest = hashlib.sha256()
    for x in given:
        digest.update(np.ascontiguousarray(x).tobytes())
    steps = gym.spec(env_id).max_episode_steps
    return digest.hexdigest(), [float(reward), float(terminated), float(steps or 0)]


def kinds_of(env_id: str) -> list[str]:
    """Kinds of results that are stored; to compile less, only Reach has every kind."""
    return [*(KINDS if "-Reach-" in env_id else EVERYWHERE), *STARTS]


def pinned(env_id: str, kind: str) -> dict[str, Any]:
    """Digests and numbers of a batch, by default of a single environment too."""
    if kind in STARTS:
        digest, few = judged(env_id, STARTS[kind])
        return {kind: {"digest": digest, "numbers": few}}
    result = {}
    for name in ("batch", "single") if kind == "default" else ("batch",):
        batch = name == "batch"
        make = partial(gym.make_vec, num_envs=BATCH) if batch else gym.make
        digest, few = followed(make(env_id, **KINDS[kind]), batch)
        result[f"{kind}, {name}"] = {"digest": digest, "numbers": few}
    return result


def close(kind: str, found: list[float], stored: list[float]) -> bool:
    """True if numbers of two processors agree to round-off."""
    return np.allclose(found, stored, rtol=1e-3 if "float32" in kind else 1e-9, atol=0.0)


@pytest.mark.parametrize(("env_id", "kind"), [(i, k) for i in flexarm_env.IDS for k in kinds_of(i)])
def test_an_environment_gives_its_stored_results(env_id: str, kind: str) -> None:
    stored = json.loads(STORE.read_text(encoding="utf-8"))
    found, numbers = pinned(env_id, kind), stored["numbers"][env_id]
    assert {name for name in numbers if name.split(", ")[0] == kind} == found.keys()
    digests = stored["digests"].get(processor(), {}).get(env_id, {})  # others lack a new id
    for name, entry in found.items():
        assert entry["digest"] == digests.get(name, entry["digest"]), name
        assert close(name, entry["numbers"], numbers[name]), name


@pytest.mark.parametrize("env_id", flexarm_env.IDS)
def test_an_environment_takes_its_steps(env_id: str) -> None:
    name = env_id.removeprefix("FlexArm/").removesuffix("-v0")
    for kind, taken in TAKEN.get(name, TAKEN.get(name.split("-")[0], {})).items():
        core = gym.make(env_id, **KINDS[kind]).unwrapped.core  # type: ignore[attr-defined]
        assert (core.integrator, core.substeps) == taken, kind


@pytest.mark.parametrize("env_id", flexarm_env.IDS)
def test_pinned_starts_succeed_and_fail(env_id: str) -> None:
    """Rest on the target is worth 1 unless the target moves; a broken link costs 100."""
    numbers = json.loads(STORE.read_text(encoding="utf-8"))["numbers"][env_id]
    settled, broken = (numbers[name] for name in STARTS)
    assert 0.0 < settled[0] <= 1.0
    assert "Track" in env_id or settled[0] == pytest.approx(1.0)
    assert broken[0] == pytest.approx(0.0 if "Goal" in env_id else -100.0, abs=1.0)
    assert (settled[1], broken[1]) == (0.0, 1.0)
    assert settled[2] == broken[2] == (240 if "Two" in env_id or "Free" in env_id else 150)


def pin(meant: Collection[str]) -> None:
    """Store the digests of this processor; of others, those of ids that are not meant to change.

    An id that changed without being meant to ends the program.
    """
    stored = json.loads(STORE.read_text(encoding="utf-8"))
    for env_id in flexarm_env.IDS:
        found = {k: x for kind in kinds_of(env_id) for k, x in pinned(env_id, kind).items()}
        before = stored["numbers"].get(env_id, {})
        numbers = {kind: entry["numbers"] for kind, entry in found.items()}
        changed = [k for k, x in numbers.items() if not close(k, x, before.get(k, [np.nan]))]
        if changed and env_id not in meant:
            raise SystemExit(f"{env_id} changed: {', '.join(changed)}. Name it if it was meant to.")
        if changed:
            stored["numbers"][env_id] = numbers
            for digests in stored["digests"].values():
                digests.pop(env_id, None)
        own = stored["digests"].setdefault(processor(), {})
        own[env_id] = {kind: entry["digest"] for kind, entry in found.items()}
    STORE.write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    pin(sys.argv[1:])
