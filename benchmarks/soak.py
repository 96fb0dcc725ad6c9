"""Many steps of every environment under random and bang-bang actions: nothing may go unsaid.

    python -m benchmarks.soak [--steps 1e8] [--out docs/results/soak.json]

After every step of every environment: observation, reward and info are finite and the observation
is within its bounds; the clock goes on by one control step or, after an episode that was said to
have ended, starts at zero; what diverged has ended and the arm is not left standing still. A tenth
of the steps is taken at 20 times the torque limit, where arms leave their validity and diverge.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import flexarm_env
from benchmarks.output import RESULTS, provenance, save_results
from flexarm_env import FlexArmVectorEnv

BATCH = 4096
OVERDRIVEN, TOO_MUCH = 0.1, 20.0  # share of the steps, times the torque limit
SWITCHES = 0.15  # chance of a bang-bang torque to change its sign, per control step


class Soak:
    """One kind of environment, watched."""

    def __init__(self, env_id: str, torque: float, threads: int = 2) -> None:
        nominal: Any = gym.make(env_id).unwrapped
        limit = (torque * np.array(nominal.torque_limit)).tolist()
        keywords: Any = {"threads": threads, "torque_limit": limit}
        self.envs = cast(FlexArmVectorEnv, gym.make_vec(env_id, num_envs=BATCH, **keywords))
        self.rng = np.random.default_rng(0)
        obs, _ = self.envs.reset(seed=0)
        self.bound = self.envs.core.layout.bounds.astype(np.float32)
        self.elapsed = np.zeros(BATCH)
        self.ended = np.zeros(BATCH, dtype=bool)
        self.sign = np.ones((BATCH, self.envs.n_joint), np.float32)
        self.before = obs
        self.counts = dict.fromkeys(
            ("steps", "time out", "invalid", "diverged", "not finite", "out of bounds",
             "clock wrong", "divergence not said", "frozen"), 0,
        )  # fmt: skip

    def actions(self) -> NDArray[np.float32]:
        """Uniform for the first half of the environments, bang-bang for the second."""
        flip = self.rng.random(self.sign.shape) < SWITCHES
        self.sign[flip] *= -1.0
        result, half = self.sign.copy(), BATCH // 2
        result[:half] = self.rng.uniform(-1.0, 1.0, (half, result.shape[1]))
        return result

    def step(self) -> None:
        """One step of all, and what is wrong with it."""
        obs, reward, terminated, truncated, info = self.envs.step(self.actions())
        self.elapsed = np.where(self.ended, 0.0, self.elapsed + 1.0)
        began, self.ended = self.ended, terminated | truncated
        numbers = [reward, *(x for x in info.values() if isinstance(x, np.ndarray))]
        finite = np.isfinite(obs).all(axis=1)
        for x in numbers:
            finite &= np.isfinite(x).reshape(BATCH, -1).all(axis=1)
        still = (obs == self.before).all(axis=1) & ~info["diverged"] & ~began
        self.before = obs
        clock = np.abs(info["time"] - self.envs.control_dt * self.elapsed) > 1e-9
        for name, bad in (
            ("steps", np.ones(BATCH, bool)), ("time out", truncated & ~terminated),
            ("invalid", terminated & ~info["diverged"]), ("diverged", info["diverged"]),
            ("not finite", ~finite), ("out of bounds", (np.abs(obs) > self.bound).any(axis=1)),
            ("clock wrong", clock), ("divergence not said", info["diverged"] & ~terminated),
            ("frozen", still),
        ):  # fmt: skip
            self.counts[name] += int(bad.sum())


WRONG = ("not finite", "out of bounds", "clock wrong", "divergence not said", "frozen")


def soak(env_id: str, steps: int) -> dict[str, int]:
    """Counts over both torque limits."""
    total: dict[str, int] = {}
    for torque, share in ((1.0, 1.0 - OVERDRIVEN), (TOO_MUCH, OVERDRIVEN)):
        watched = Soak(env_id, torque)
        for _ in tqdm(range(-int(-share * steps // BATCH)), desc=f"{env_id} x{torque:g}"):
            watched.step()
        watched.envs.close()
        for name, count in watched.counts.items():
            total[name] = total.get(name, 0) + count
    return total


def table(results: dict[str, Any]) -> str:
    """The counts as a page."""
    names = list(next(iter(results["counts"].values())))
    total = sum(row["steps"] for row in results["counts"].values())
    lines = [
        "# Soak\n",
        f"Made by `{results['command']}`: {total:.3g} steps. Half the environments take uniform "
        f"actions, half bang-bang; a tenth of the steps is at {TOO_MUCH:g} times the torque "
        "limit. The last five columns count what must not happen.\n",
        "| environment | " + " | ".join(names) + " |",
        "|---|" + "---:|" * len(names),
    ]
    lines += [
        f"| {env_id} | " + " | ".join(f"{row[name]:,}" for name in names) + " |"
        for env_id, row in results["counts"].items()
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Soak, print, write; the exit status is 1 if anything went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=float, default=1e8, help="in all (default 1e8)")
    parser.add_argument("--out", type=Path, default=RESULTS / "soak.json")
    options = parser.parse_args()
    begin = time.perf_counter()
    each = int(options.steps / len(flexarm_env.IDS))
    counts = {env_id: soak(env_id, each) for env_id in flexarm_env.IDS}
    results = {**provenance("numba", "numpy"), "seconds": time.perf_counter() - begin,
               "counts": counts}  # fmt: skip
    text = table(results)
    print(text)
    save_results(results, text, options.out)
    return int(any(row[name] for row in counts.values() for name in WRONG))


if __name__ == "__main__":
    sys.exit(main())
