"""Soak test: many steps of every environment under random and bang-bang actions.

    python -m benchmarks.speed.soak [--steps 1e8] [--out docs/results/soak.json]

Checks after every step of every environment: observation, reward and info are finite, and the
observation is within its bounds; the clock advances by one control step, or starts at zero after an
episode that was reported as ended; a diverged episode is terminated; the observation changes. A
tenth of the steps is taken at 20 times the torque limit, where arms leave their validity and
diverge.
"""

import sys
import time
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

import flexarm_env
from benchmarks.output import argument_parser, paragraphs, provenance, save_results, table
from flexarm_env import FlexArmVectorEnv

BATCH, THREADS = 4096, 2
OVERDRIVEN, OVERDRIVE = 0.1, 20.0  # share of the steps, and their torque over the torque limit
SWITCHES = 0.15  # probability per control step that a bang-bang torque changes its sign


def side_by_side(obs: Any) -> NDArray[np.float32]:
    """(BATCH, n) observations, those of goals in the order of their dict."""
    parts = list(obs.values()) if isinstance(obs, dict) else [obs]
    return np.concatenate(parts, axis=1)


class Soak:
    """A batch of one environment, and counts of its steps, ends and faults."""

    def __init__(self, env_id: str, torque: float) -> None:
        nominal: Any = gym.make(env_id).unwrapped
        limit = (torque * np.array(nominal.torque_limit)).tolist()
        keywords: Any = {"threads": THREADS, "torque_limit": limit}
        self.envs = cast(FlexArmVectorEnv, gym.make_vec(env_id, num_envs=BATCH, **keywords))
        self.rng = np.random.default_rng(0)
        obs, _ = self.envs.reset(seed=0)
        self.bound = self.envs.core.layout.bounds.astype(np.float32)
        self.elapsed = np.zeros(BATCH)
        self.ended = np.zeros(BATCH, dtype=bool)
        self.sign = np.ones((BATCH, self.envs.n_joint), np.float32)
        self.before = side_by_side(obs)
        self.counts = dict.fromkeys(
            ("steps", "time out", "invalid", "diverged", "not finite", "out of bounds",
             "clock wrong", "divergence not said", "frozen"), 0,
        )  # fmt: skip

    def actions(self) -> NDArray[np.float32]:
        """Uniform actions for the first half of the environments, bang-bang for the second."""
        flip = self.rng.random(self.sign.shape) < SWITCHES
        self.sign[flip] *= -1.0
        result, half = self.sign.copy(), BATCH // 2
        result[:half] = self.rng.uniform(-1.0, 1.0, (half, result.shape[1]))
        return result

    def step(self) -> None:
        """Step all environments once and count the faults."""
        seen, reward, terminated, truncated, info = self.envs.step(self.actions())
        obs = side_by_side(seen)
        self.elapsed = np.where(self.ended, 0.0, self.elapsed + 1.0)
        restarted, self.ended = self.ended, terminated | truncated
        numbers = [reward, *(x for x in info.values() if isinstance(x, np.ndarray))]
        finite = np.isfinite(obs).all(axis=1)
        for x in numbers:
            finite &= np.isfinite(x).reshape(BATCH, -1).all(axis=1)
        still = (obs == self.before).all(axis=1) & ~info["diverged"] & ~restarted
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
    """Counts of one environment, summed over both torques."""
    total: dict[str, int] = {}
    for torque, share in ((1.0, 1.0 - OVERDRIVEN), (OVERDRIVE, OVERDRIVEN)):
        batch = Soak(env_id, torque)
        for _ in tqdm(range(-int(-share * steps // BATCH)), desc=f"{env_id} x{torque:g}"):
            batch.step()
        batch.envs.close()
        for name, count in batch.counts.items():
            total[name] = total.get(name, 0) + count
    return total


def page(results: dict[str, Any]) -> str:
    """The counts as Markdown."""
    names = list(next(iter(results["counts"].values())))
    total = sum(row["steps"] for row in results["counts"].values())
    return paragraphs(
        "# Soak",
        f"Made by `{results['command']}`: {total:.3g} steps. Half the environments take uniform "
        f"actions, half bang-bang; a tenth of the steps is at {OVERDRIVE:g} times the torque "
        "limit. The last five columns count what must not happen.",
        table(
            ["environment", *names],
            [
                [env_id, *(f"{row[name]:,}" for name in names)]
                for env_id, row in results["counts"].items()
            ],
            "lr",
        ),
    )


def main() -> int:
    """Soak all environments, print and write the counts; returns 1 if there was any fault."""
    parser = argument_parser("speed.soak", __doc__, "soak.json")
    parser.add_argument(
        "--steps", type=float, default=1e8, help="steps of all environments together (1e8)"
    )
    options = parser.parse_args()
    begin = time.perf_counter()
    each = int(options.steps / len(flexarm_env.IDS))
    counts = {env_id: soak(env_id, each) for env_id in flexarm_env.IDS}
    results = {**provenance("numba", "numpy"), "seconds": time.perf_counter() - begin,
               "counts": counts}  # fmt: skip
    save_results(results, page, options.out)
    return int(any(row[name] for row in counts.values() for name in WRONG))


if __name__ == "__main__":
    sys.exit(main())
