"""`python -m agents.leaderboard.bound`: the shortest settling times that any torques can reach.

For one episode, with its own payload and stiffness, this looks for the smallest step K such that
some admissible actions keep the tip in the settled band from K to the end of the episode, and no
link bends beyond its limit. For a given K, the actions are improved by successive linear programs:
the effect of every single action on every later tip error comes from a batch of environments that
differ in that action alone, and the largest error after K is minimised within a trust region. A
solution counts only if the environment itself, stepped with it, stays in the band. K falls until no
program helps. Every episode starts from two controllers; the better result is kept, and both are
reported. The result is the best known, not a proof.

    python -m agents.leaderboard.bound --tasks FlexArm/OneLink-Reach-v0 --episodes 100
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog

from agents.controllers import controller
from agents.files import atomic_write
from agents.leaderboard.tracks import RANKED, TRACKS
from agents.metrics import HOLD, make_batch
from agents.tune import parameters_of
from dynamics.description import validate
from dynamics.load import load_arm
from dynamics.types import Array
from flexarm_env import IDS, TASKS
from flexarm_env.hardware.sensors import load_hardware
from flexarm_env.tasks import SETTLED_BAND

FOLDER = Path(__file__).parents[1] / "bounds"
PLANTS = ("state", "laboratory")  # tracks whose plants differ in free parameters alone
STARTS = ("lqr", "pd")  # controllers whose actions the search begins with
NUDGE = 1e-3  # [-] change of an action for its effect
TRUST = (0.5, 0.01)  # [-] first and last largest change of an action
ROUNDS = 8  # linear programs per K
MARGIN = 0.999  # of the band and of the deflection limit, for the programs
DIRECTIONS = 16  # of a polygon that stands for the circle of the band


@dataclass(frozen=True)
class Motion:
    """Actions and what they do in the environment."""

    actions: Array  # (T, m)
    errors: Array  # (T, k) [-] tip errors over the band
    deflection: Array  # (T,) [-] over its limit
    settled: int  # first step from which the tip stays in the band, T if none
    valid: bool  # the episode did not end early


class Episode:
    """One episode, which may be repeated with any actions."""

    def __init__(
        self, env_id: str, kwargs: Mapping[str, Any], seed: int, batches: dict[int, Any]
    ) -> None:
        self.env_id, self.kwargs, self.seed = env_id, dict(kwargs), seed
        steps, self.dt = IDS[env_id]["max_episode_steps"], IDS[env_id]["kwargs"]["control_dt"]
        self.steps, self.held = steps, steps - round(HOLD / self.dt)
        self._batches = batches

    def batch(self, n_env: int) -> Any:
        """A batch whose environments all have this episode."""
        if n_env not in self._batches:
            self._batches[n_env] = make_batch(self.env_id, n_env, self.kwargs)
        envs = self._batches[n_env]
        observation, _ = envs.reset(seed=[self.seed] * n_env)
        return envs, observation

    def follow(self, actions: Array) -> list[Motion]:
        """Motions under several sequences of actions (P, T, m)."""
        envs, _ = self.batch(len(actions))
        base = envs.unwrapped
        part = base.observation_slices["tip_error"]
        scale = base.observation_scales["tip_error"] / (SETTLED_BAND * base.reach)
        limit = base.core.arguments["deflection_limit"]
        errors, deflection, distance, ended = [], [], [], np.zeros(len(actions), bool)
        for k in range(self.steps):
            observation, _, terminated, _, info = envs.step(actions[:, k].astype(np.float32))
            ended |= terminated
            errors.append(observation[:, part] * scale)
            deflection.append(info["deflection"] / limit)
            distance.append(info["tip_error"] / (SETTLED_BAND * base.reach))
        outside = np.array(distance) >= 1.0
        last = np.where(outside.any(axis=0), self.steps - outside[::-1].argmax(axis=0), 0)
        return [
            Motion(a, e, d, int(s), not over)
            for a, e, d, s, over in zip(
                actions, np.array(errors).transpose(1, 0, 2), np.array(deflection).T, last, ended,
                strict=True,
            )
        ]  # fmt: skip

    def acted(self, subject: Any) -> Array:
        """(T, m) actions of a controller in this episode."""
        envs, observation = self.batch(1)
        state, start, actions = None, np.ones(1, bool), []
        for _ in range(self.steps):
            action, state = subject.predict(observation, state, start)
            actions.append(np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)[0])
            observation, _, terminated, _, _ = envs.step(np.asarray(action, np.float32))
            start = terminated
        return np.array(actions)


def effects(episode: Episode, motion: Motion) -> tuple[Array, Array]:
    """(T, k, T m) of the errors and (T, T m) of the deflection: slopes by every single action."""
    count = motion.actions.size
    nudged = np.tile(motion.actions, (count + 1, 1, 1)).reshape(count + 1, -1)
    sign = np.where(nudged[0] > 0.0, -NUDGE, NUDGE)
    nudged[np.arange(count), np.arange(count)] += sign
    found = episode.follow(nudged.reshape(count + 1, *motion.actions.shape))
    here = found[-1]
    slopes = [(x.errors - here.errors) / s for x, s in zip(found, sign, strict=False)]
    bends = [(x.deflection - here.deflection) / s for x, s in zip(found, sign, strict=False)]
    return np.stack(slopes, axis=-1), np.stack(bends, axis=-1)


def directions(size: int) -> Array:
    """(d, size) unit vectors whose half-spaces stand for a ball."""
    if size == 1:
        return np.array([[1.0], [-1.0]])
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    if size == 2:
        return circle
    raised = [np.column_stack([c * circle, np.full(len(circle), s)])
              for c, s in ((1.0, 0.0), (0.71, 0.71), (0.71, -0.71))]  # fmt: skip
    return np.vstack([*raised, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])


def largest(motion: Motion, first: int) -> float:
    """Largest tip error from a step on, over the band; infinite for an episode that ended early."""
    if not motion.valid:
        return np.inf
    return float(np.linalg.norm(motion.errors[first:], axis=1).max())


def improved(episode: Episode, motion: Motion, first: int) -> Motion:
    """Motion whose largest error from step `first` on is as small as the programs make it."""
    trust, rounds = TRUST[0], 0
    while rounds < ROUNDS and trust > TRUST[1] and motion.settled > first:
        slopes, bends = effects(episode, motion)
        change = program(motion, slopes, bends, first, trust)
        if change is None:
            return motion
        better = episode.follow((motion.actions + change)[None])[0]
        if largest(better, first) < largest(motion, first):
            motion = better
        else:
            trust *= 0.25
        rounds += 1
    return motion


def program(motion: Motion, slopes: Array, bends: Array, first: int, trust: float) -> Array | None:
    """(T, m) change of the actions that minimises the largest error from `first` on, linearly."""
    normals = directions(motion.errors.shape[1])
    rows = np.einsum("dk,tkx->tdx", normals, slopes[first:]).reshape(-1, motion.actions.size)
    values = (motion.errors[first:] @ normals.T).ravel()
    A = np.vstack(
        [np.column_stack([rows, -np.ones(len(rows))]), np.column_stack([bends, 0.0 * bends[:, :1]])]
    )
    b = np.concatenate([-values, MARGIN - motion.deflection])
    flat = motion.actions.ravel()
    low, high = np.maximum(-trust, -1.0 - flat), np.minimum(trust, 1.0 - flat)
    bounds = [*zip(low, high, strict=True), (0.0, None)]
    cost = np.zeros(flat.size + 1)
    cost[-1] = 1.0
    found = linprog(cost, A_ub=A, b_ub=b,
                    bounds=bounds, method="highs")  # fmt: skip
    return found.x[:-1].reshape(motion.actions.shape) if found.status == 0 else None


def shortest(episode: Episode, motion: Motion) -> Motion:
    """Motion that settles as early as successive programs find."""
    if motion.settled > episode.held:
        motion = improved(episode, motion, episode.held)
    if motion.settled > episode.held:
        return motion
    stride = max(1, motion.settled // 4)
    while stride:
        wanted = motion.settled - stride
        trial = improved(episode, motion, wanted) if wanted >= 0 else motion
        if trial.valid and trial.settled <= wanted:
            motion = trial
        else:
            stride //= 2
    return motion


def plant(env_id: str, track: str) -> dict[str, Any]:
    """Keywords of an environment with the plants of a track and an exact observation."""
    hardware = load_hardware(TRACKS[track].kwargs.get("hardware"))
    if hardware is None:
        return {"obs": "state"}
    return {"obs": "state", "randomize": hardware.spread(load_arm(IDS[env_id]["kwargs"]["arm"]))}


def bounded(
    env_id: str, track: str, seed: int, batches: dict[int, Any]
) -> tuple[Motion, list[float]]:
    """Best motion that was found, and the settling time [s] from every start.

    `batches` keeps environments for the next episode of the same task and track.
    """
    kwargs = plant(env_id, track)
    episode, found = Episode(env_id, kwargs, seed, batches), []
    for name in STARTS:
        subject = controller(name, episode.batch(1)[0], parameters_of(name, env_id, "state"))
        first = episode.follow(episode.acted(subject)[None])[0]
        if not first.valid:
            first = episode.follow(np.zeros((1, *first.actions.shape)))[0]
        found.append(shortest(episode, first))
    settled = [x.valid and x.settled <= episode.held for x in found]
    times = [x.settled * episode.dt if y else np.inf for x, y in zip(found, settled, strict=True)]
    return found[int(np.argmin(times))], times


def file_of(env_id: str, track: str) -> Path:
    """File of the bounds of a task with the plants of a track."""
    return FOLDER / f"{env_id.split('/')[1]}.{track}.npz"


@cache
def stored(env_id: str, track: str) -> dict[int, float]:
    """Shortest known settling time [s] by seed; empty if none is stored."""
    path = file_of(env_id, track)
    if not path.exists():
        return {}
    with np.load(path, allow_pickle=False) as data:
        found = zip(data["seeds"].tolist(), data["times"].tolist(), strict=True)
        return {seed: time for seed, time in found if np.isfinite(time)}


def shortest_times(env_id: str, track: str, seeds: Sequence[int]) -> Array | None:
    """(n,) [s] shortest known settling times of episodes; None unless all are stored."""
    known = stored(env_id, track)
    if not all(seed in known for seed in seeds):
        return None
    return np.array([known[seed] for seed in seeds])


def save(path: Path, seeds: Sequence[int], motions: Sequence[Motion], times: Array) -> None:
    """Write seeds (n,), times (n, starts) [s] and actions (n, T, m)."""
    path.parent.mkdir(exist_ok=True)
    actions = np.array([motion.actions for motion in motions], dtype=np.float32)
    with atomic_write(path) as temporary:
        np.savez_compressed(
            temporary, seeds=np.array(seeds), times=times.min(axis=1), starts=times, actions=actions
        )


def main(arguments: list[str] | None = None) -> int:
    """Search the bounds of tasks and store them; the exit status."""
    ranked = [i for i in RANKED if not TASKS[IDS[i]["kwargs"]["task"]].moving]
    parser = argparse.ArgumentParser(prog="python -m agents.leaderboard.bound", description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=ranked, metavar="ID")
    parser.add_argument("--track", default="state", help="whose plants: state or laboratory")
    parser.add_argument("--seed", type=int, default=10_000, help="of the first episode")
    parser.add_argument("--episodes", type=int, default=100)
    options = parser.parse_args(arguments)
    try:
        for env_id in options.tasks:
            validate.known(env_id, "task", ranked)
        validate.known(options.track, "track", PLANTS)
        validate.integer(options.seed, "--seed", 0, 2**31)
        validate.integer(options.episodes, "--episodes", 1, 100_000)
    except ValueError as error:
        print(f"agents.leaderboard.bound: {error}", file=sys.stderr)
        return 2
    seeds = range(options.seed, options.seed + options.episodes)
    for env_id in options.tasks:
        found: list[tuple[Motion, list[float]]] = []
        batches: dict[int, Any] = {}
        for seed in seeds:
            found.append(bounded(env_id, options.track, seed, batches))
            reached = zip(STARTS, found[-1][1], strict=True)
            line = ", ".join(f"{name} {t:.2f} s" for name, t in reached)
            print(f"{env_id}, seed {seed}: from {line}", flush=True)
        times = np.array([x[1] for x in found])
        save(file_of(env_id, options.track), list(seeds), [x[0] for x in found], times)
        print(f"{env_id}: {_agreement(times)}")
    return 0


def _agreement(times: Array) -> str:
    near = np.ptp(times, axis=1) <= 0.05 * times.min(axis=1)
    return (
        f"median {np.median(times.min(axis=1)):.3f} s; starts agree within 5 % in {near.mean():.0%}"
    )


if __name__ == "__main__":
    sys.exit(main())
