"""`python -m agents.leaderboard.bound`: the best that any torques are known to reach.

For one episode, with its own payload and stiffness, this looks for the smallest step K such that
some admissible actions keep the tip in the settled band from K to the end of the episode, and no
link bends beyond its limit; where the target moves, for the smallest RMS tip error. The actions are
improved successively: the effect of every single action on every later tip error comes from exact
derivatives of the control steps, and the excess over the band after K is minimised within a trust
region by L-BFGS-B. A solution counts only if the environment itself, stepped with
it, stays in the band. K falls until no program helps. Every episode starts from two controllers;
the better result is kept, and both are stored. The result is the best known, not a proof.

    python -m agents.leaderboard.bound --tasks FlexArm/OneLink-Reach-v0 --episodes 100
    python -m agents.leaderboard.bound --tasks FlexArm/OneLink-Reach-v0 --replay

Every finished episode is stored at once; episodes that are stored are not searched again, unless
`--again` asks for it: then their stored actions are a third start. `--replay` steps the stored
actions through the environment and compares.
"""

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from scipy.optimize import minimize

from agents.controllers import controller
from agents.files import atomic_write, check_folder
from agents.leaderboard.motions import Episode, Motion, plant
from agents.leaderboard.tracks import RANKED
from agents.metrics import Best
from agents.sentences import refused
from agents.signals import workers
from agents.tuned import parameters_of
from dynamics.command import completed
from dynamics.description import validate
from dynamics.description.data_file import user_path
from dynamics.types import Array
from flexarm_env import IDS, TASKS
from flexarm_env.task.tasks import SETTLED_BAND

FOLDER = Path(__file__).parents[1] / "bounds"
STARTS = ("mpc", "pd")  # controllers whose actions the search begins with
PLANTS = ("state", "laboratory")  # tracks whose plants differ in free parameters alone
TRUST = (0.5, 0.01)  # [-] first and last largest change of an action
ROUNDS = 12  # programs per aim
MARGIN = 0.97  # of the band and of the deflection limit, for the programs
BENDING = 30.0  # weight of the excess over the deflection limit
LITTLE = 1e-7  # weight of the squared change of the actions
GAIN = 0.99  # of the RMS error; a smaller gain ends the search
EFFORT = {"maxiter": 300, "maxcor": 20, "ftol": 1e-12, "gtol": 1e-7}  # of a program


@dataclass(frozen=True)
class Aim:
    """Stay within the band from a step on; without a band, as close as possible throughout."""

    first: int = 0
    band: float = 0.0  # over the settled band

    def loss(self, motion: Motion) -> float:
        """Largest distance after the first step, or the RMS; infinite if the episode failed."""
        if not motion.valid:
            return np.inf
        return float(motion.distance[self.first :].max()) if self.band else motion.rms

    def met(self, motion: Motion) -> bool:
        """True if nothing is left to do."""
        return bool(self.band) and motion.valid and motion.settled <= self.first


def improved(episode: Episode, motion: Motion, aim: Aim) -> Motion:
    """Motion that comes as near to an aim as the programs bring it."""
    trust, rounds = TRUST[0], 0
    while rounds < ROUNDS and trust > TRUST[1] and not aim.met(motion):
        change = program(motion, *episode.effects(motion), aim, trust)
        trial = episode.follow((motion.actions + change)[None])[0]
        better, rounds = aim.loss(trial) < aim.loss(motion), rounds + 1
        if better and not aim.band and aim.loss(trial) > GAIN * aim.loss(motion):
            return trial
        motion, trust = (trial, trust) if better else (motion, 0.25 * trust)
    return motion


def program(motion: Motion, slopes: Array, bends: Array, aim: Aim, trust: float) -> Array:
    """(T, m) change of the actions that minimises the squared excess over band and limit."""
    size, errors = motion.actions.size, motion.errors[aim.first :]
    J = slopes[aim.first :].reshape(-1, size)
    near = motion.deflection + trust * np.abs(bends).sum(axis=1) > MARGIN
    G, bent = bends[near], motion.deflection[near]

    def excess(x: Array) -> tuple[float, Array]:
        y = errors + (J @ x).reshape(errors.shape)
        length = np.linalg.norm(y, axis=1)
        over = np.maximum(length - MARGIN * aim.band, 0.0)
        beyond = BENDING * np.maximum(bent + G @ x - MARGIN, 0.0)
        pull = (over / np.maximum(length, 1e-9))[:, None] * y
        slope = J.T @ pull.ravel() + BENDING * G.T @ beyond + LITTLE * x
        return 0.5 * float(over @ over + beyond @ beyond + LITTLE * x @ x), slope

    flat = motion.actions.ravel()
    low, high = np.maximum(-trust, -1.0 - flat), np.minimum(trust, 1.0 - flat)
    found = minimize(
        excess, np.zeros(size), jac=True, method="L-BFGS-B", bounds=np.column_stack([low, high]),
        options=EFFORT,
    )  # fmt: skip
    return np.asarray(found.x).reshape(motion.actions.shape)


def shortest(episode: Episode, motion: Motion) -> Motion:
    """Motion that settles as early as successive programs find."""
    if motion.settled > episode.held:
        motion = improved(episode, motion, Aim(episode.held, 1.0))
    if motion.settled > episode.held:
        return motion
    stride = max(1, motion.settled // 4)
    while stride:
        wanted = motion.settled - stride
        trial = improved(episode, motion, Aim(wanted, 1.0)) if wanted >= 0 else motion
        if trial.valid and trial.settled <= wanted:
            motion = trial
        else:
            stride //= 2
    return motion


def is_moving(env_id: str) -> bool:
    """True if the target of a task moves."""
    return TASKS[IDS[env_id]["kwargs"]["task"]].moving


def reached(episode: Episode, motion: Motion) -> float:
    """Settling time [s], or RMS tip error [m] where the target moves; infinite if neither.

    As agents.metrics has them, of the start and all steps: step 0 of a motion ends after 1 dt.
    """
    if not motion.valid:
        return np.inf
    if is_moving(episode.env_id):
        rms = np.sqrt(np.mean(np.square([episode.start, *motion.distance])))
        return float(rms) * SETTLED_BAND * episode.reach
    if motion.settled == 0 and episode.start < 1.0:
        return 0.0
    return (motion.settled + 1) * episode.dt if motion.settled <= episode.held else np.inf


def bounded(
    env_id: str, track: str, seed: int, batches: dict[int, Any], before: Array | None = None
) -> tuple[Motion, list[float]]:
    """Best motion that was found, and what was reached from every start.

    Actions `before`, (T, m), are the last start. `batches` keeps environments for the next episode
    of the same task and track.
    """
    episode, found = Episode(env_id, plant(env_id, track), seed, batches), []
    search = partial(improved, aim=Aim()) if is_moving(env_id) else shortest
    for name in STARTS:
        subject = controller(name, episode.batch(1)[0], parameters_of(name, env_id, "state"))
        first = episode.follow(episode.acted(subject)[None])[0]
        if not first.valid:
            first = episode.follow(np.zeros((1, *first.actions.shape)))[0]
        found.append(search(episode, first))
    if before is not None:
        found.append(search(episode, episode.follow(before[None].astype(np.float64))[0]))
    best = [reached(episode, motion) for motion in found]
    return found[int(np.argmin(best))], best


# ---- stored bounds -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Bounds:
    """Bounds of n episodes."""

    seeds: Array  # (n,) of the episodes
    best: Array  # (n,) [s] settling time, or [m] RMS tip error
    starts: Array  # (n, starts) the same from every controller that the search began with
    actions: Array  # (n, T, m)

    @property
    def agreement(self) -> float:
        """Share of the episodes in which all starts reach the best within AGREED."""
        return float(np.mean(self.starts.max(axis=1) <= (1.0 + AGREED) * self.best))


AGREED = 0.05  # of the best value
DIMENSIONS = {"seeds": 1, "best": 1, "starts": 2, "actions": 3}


def file_of(env_id: str, track: str, folder: Path | None = None) -> Path:
    """File of the bounds of a task with the plants of a track, in the package or in a folder."""
    return (folder or FOLDER) / f"{env_id.split('/')[1]}.{track}.npz"


@cache
def stored(env_id: str, track: str, folder: Path | None = None) -> Bounds | None:
    """Bounds that are stored for a task with the plants of a track, if any."""
    path = file_of(env_id, track, folder)
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {name: data[name] for name in DIMENSIONS}
    except (ValueError, KeyError, EOFError, BadZipFile) as error:
        raise ValueError(f"{path} cannot be read as stored bounds: {error}.") from None
    for name, wanted in DIMENSIONS.items():
        if arrays[name].ndim != wanted:
            raise ValueError(
                f"{path}: the dimensions of {name} must be {wanted}, got {arrays[name].ndim}."
            )
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{path}: all arrays must have one row per episode, got {lengths}.")
    return Bounds(**arrays)


def known(env_id: str, track: str, folder: Path | None = None) -> dict[int, tuple[float, Array]]:
    """Best value and actions (T, m) by seed of all searched episodes; infinite if none was found.

    A folder adds its bounds to those of the package; the better one counts.
    """
    result: dict[int, tuple[float, Array]] = {}
    for place in {None, folder}:
        found = stored(env_id, track, place)
        if found is not None:
            for seed, value, actions in zip(
                found.seeds.tolist(), found.best.tolist(), found.actions, strict=True
            ):
                if seed not in result or value < result[seed][0]:
                    result[seed] = value, actions
    return result


def best_of(
    env_id: str, track: str, seeds: Sequence[int], folder: Path | None = None
) -> Best | None:
    """Best that is known of episodes; None if fewer than two have a bound."""
    bounds = known(env_id, track, folder)
    values = np.array([bounds[seed][0] if seed in bounds else np.nan for seed in seeds])
    values[~np.isfinite(values)] = np.nan
    metric = "tip_error_rms" if is_moving(env_id) else "settling_time"
    return Best(metric, values) if np.sum(values > 0.0) > 1 else None


def add(
    env_id: str,
    track: str,
    seed: int,
    motion: Motion,
    starts: Sequence[float],
    folder: Path | None = None,
) -> None:
    """Store one more episode, in place of an earlier bound; the file is replaced as a whole."""
    from_controllers = starts[: len(STARTS)]
    new = Bounds(
        np.array([seed]), np.array([min(starts)]), np.array([from_controllers]),
        motion.actions[None].astype(np.float32),
    )  # fmt: skip
    stored.cache_clear()  # another process may have added episodes
    old, path = stored(env_id, track, folder), file_of(env_id, track, folder)
    arrays = {name: getattr(new, name) for name in DIMENSIONS}
    if old is not None:
        others = old.seeds != seed
        order = np.argsort([*old.seeds[others], seed])
        for name, row in arrays.items():
            arrays[name] = np.concatenate([getattr(old, name)[others], row])[order]
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        np.savez_compressed(temporary, **arrays)
    stored.cache_clear()


def compute(
    env_id: str,
    track: str,
    seeds: Iterable[int],
    jobs: int = 1,
    folder: Path | None = None,
    again: bool = False,
) -> None:
    """Search the bounds of the episodes that have none, or of all; store them.

    They go to the package or to a folder.
    """
    there = known(env_id, track, folder)
    wanted = [seed for seed in seeds if again or seed not in there]
    before = [there[seed][1] if seed in there else None for seed in wanted]
    names = (*STARTS, "stored")
    with workers(jobs) as pool:
        results = pool.map(partial(_searched, env_id, track), wanted, before)
        for done, (seed, (motion, starts)) in enumerate(zip(wanted, results, strict=True), 1):
            add(env_id, track, seed, motion, starts, folder)
            line = ", ".join(
                f"{name} {value:.4g}" for name, value in zip(names, starts, strict=False)
            )
            print(
                f"{env_id}, {track}, bound {done} of {len(wanted)}, seed {seed}: from {line}",
                flush=True,
            )


_BATCHES: dict[tuple[str, str], dict[int, Any]] = {}  # of a worker


def _searched(
    env_id: str, track: str, seed: int, before: Array | None
) -> tuple[Motion, list[float]]:
    return bounded(env_id, track, seed, _BATCHES.setdefault((env_id, track), {}), before)


def replay(env_id: str, track: str, found: Bounds) -> tuple[Array, Array]:
    """(n,) stored bounds, and those that the stored actions reach in the environment now."""
    batches: dict[int, Any] = {}
    again = []
    for seed, actions in zip(found.seeds.tolist(), found.actions, strict=True):
        episode = Episode(env_id, plant(env_id, track), seed, batches)
        again.append(reached(episode, episode.follow(actions[None].astype(np.float64))[0]))
    return found.best, np.array(again)


def main(arguments: list[str] | None = None) -> int:
    """Search the bounds of tasks and store them, or replay them; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m agents.leaderboard.bound", description=__doc__)
    parser.add_argument("--tasks", nargs="+", default=list(RANKED), metavar="ID")
    parser.add_argument("--track", default="state", help="whose plants: state or laboratory")
    parser.add_argument("--seed", type=int, default=10_000, help="of the first episode")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--again", action="store_true", help="search what is stored, and from it")
    parser.add_argument("--replay", action="store_true", help="check what is stored")
    parser.add_argument(
        "--out", type=user_path, default=FOLDER, metavar="DIR",
        help="folder of the bounds (default: that of the package, which rankings use)",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    try:
        for env_id in options.tasks:
            validate.known(env_id, "task", RANKED)
        validate.known(options.track, "track", PLANTS)
        validate.integer(options.seed, "--seed", 0, 2**31)
        validate.integer(options.episodes, "--episodes", 1, 100_000)
        validate.integer(options.jobs, "--jobs", 1, 1024)
        if not options.replay:
            check_folder(options.out)
        for env_id in options.tasks:
            known(env_id, options.track, options.out)  # refuses a damaged file before the search
    except ValueError as error:
        return refused(parser.prog, error)
    seeds, passed = range(options.seed, options.seed + options.episodes), True
    for env_id in options.tasks:
        if not options.replay:
            compute(env_id, options.track, seeds, options.jobs, options.out, options.again)
        found = stored(env_id, options.track, options.out)
        summary = "no bounds are stored" if found is None else _summary(env_id, found)
        print(f"{env_id}, {options.track}: {summary}")
        if options.replay and found is not None:
            before, now = replay(env_id, options.track, found)
            same = np.isclose(before, now, rtol=1e-3)
            print(f"  replayed: {same.sum()} of {same.size} reach what is stored")
            passed = passed and bool(same.all())
    return 0 if passed else 1


def _summary(env_id: str, found: Bounds) -> str:
    count = len(found.seeds)
    unit, scale = ("mm RMS", 1e3) if is_moving(env_id) else ("s", 1.0)
    return (
        f"{count} episode{'s' * (count > 1)}, median {scale * np.median(found.best):.3g} {unit}; "
        f"starts agree within {100 * AGREED:g} % in {found.agreement:.0%}"
    )


if __name__ == "__main__":
    sys.exit(completed("agents.leaderboard.bound", main))
