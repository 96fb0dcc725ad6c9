"""`python -m agents.evaluate RUN_OR_CONTROLLER --env ID`: evaluate a policy or controller."""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import yaml

from agents.comparison import compare
from agents.controllers import CONTROLLERS, controller, joint_pd, tune_pd
from agents.environments import (
    REFUSALS,
    check_keywords,
    look_in_present_folder,
    observation_kind,
)
from agents.files import FolderError, check_folder
from agents.hybrid.controller import acting
from agents.leaderboard.replay import OPTIMAL, optimal
from agents.leaderboard.tracks import takes_part, track_of
from agents.learners.export import load_zip
from agents.learners.limits import LIMITS
from agents.metrics import make_batch
from agents.policy import JSON_FILE, WEIGHTS_FILE, Controller, Policy, PolicyError, load_policy
from agents.run_folder.folder import RunFolder, refuse_other_arm, versions
from agents.run_folder.lock import folder_lock
from agents.sentences import one_line, refused
from agents.signals import Interrupted, signals_to, stop_at_once
from agents.tuned import is_tuned, parameters_of
from dynamics.command import completed
from dynamics.description import validate
from dynamics.description.data_file import user_path
from flexarm_env import registered

KNOWN = sorted({*CONTROLLERS, OPTIMAL})
STORED = (JSON_FILE, WEIGHTS_FILE)  # files that stand for their folder
SENSING = "lqg"  # advice for imperfect hardware


class UsageError(ValueError):
    """A command line that cannot be carried out; the message is one sentence for the user."""


def main(arguments: list[str] | None = None, prog: str = "python -m agents.evaluate") -> int:
    """Run the command line; returns the exit status (2 and one sentence for unusable input)."""
    parser = argparse.ArgumentParser(
        prog=prog, description="Evaluate a policy or a controller on seeded episodes."
    )
    parser.add_argument(
        "subject", metavar="RUN_OR_CONTROLLER", help=f"a run's folder, or one of {', '.join(KNOWN)}"
    )
    parser.add_argument(
        "--env", metavar="ID",
        help="environment id, with --env-kwargs alone (default: a run's own, with its keywords)",
    )  # fmt: skip
    parser.add_argument("--env-kwargs", metavar="YAML", help="e.g. '{obs: sensors}' (a run's own)")
    parser.add_argument("--episodes", type=int, default=100, metavar="N")
    parser.add_argument("--seed", type=int, default=10_000, metavar="S", help="first of N seeds")
    parser.add_argument(
        "--out", type=user_path, required=True, metavar="DIR",
        help="folder, whose former evaluation is replaced",
    )  # fmt: skip
    parser.add_argument("--trust", action="store_true", help="allow unpickling an SB3 zip")
    a = parser.parse_args(arguments)
    try:
        with signals_to(stop_at_once):
            evaluate(a)
    except (UsageError, PolicyError, FolderError) as error:
        return refused(prog, error)
    except OSError as error:
        return refused(prog, f"writing to {a.out} failed ({error.strerror or error}).", 1)
    except Interrupted as error:
        return refused(prog, "interrupted; run it again for the results.", error.status)
    print(f"Everything is in {a.out}/")
    return 0


def evaluate(a: argparse.Namespace) -> None:
    """Evaluate as the command line requests; nothing is written before all of it is checked."""
    for name in ("episodes", "seed"):
        low, high = LIMITS[name]
        if not low <= getattr(a, name) <= high:
            raise UsageError(
                f"--{name} must be between {low:_} and {high:_}, got {getattr(a, name)}."
            )
    check_folder(a.out)
    if RunFolder(a.out).config.is_file():
        raise UsageError(
            f"--out {a.out} is a run's folder, whose own evaluation would be replaced; choose "
            "another --out."
        )
    env_kwargs = parse_kwargs(a.env_kwargs)
    policy = find_policy(a.subject, a.trust)
    env_id, kwargs = find_env(policy, a.env, env_kwargs)
    if policy is not None and a.env is None and env_kwargs is None and kwargs:
        print(f"{env_id} with the keywords of the training: {validate.shown(kwargs)}")
    if a.subject == OPTIMAL:
        name, subject = a.subject, bounds_of(env_id, kwargs, range(a.seed, a.seed + a.episodes))
    else:
        name, subject = make_controller(a.subject, policy, env_id, kwargs)
    a.out.mkdir(parents=True, exist_ok=True)
    with folder_lock(a.out):
        compare(
            {name: subject},
            env_id,
            kwargs,
            episodes=a.episodes,
            seed=a.seed,
            folder=a.out,
            about={"subject": a.subject, "versions": versions()["packages"]},
        )


def parse_kwargs(text: str | None) -> dict[str, Any] | None:
    """Environment keywords from one line of YAML."""
    if text is None:
        return None
    try:
        return check_keywords(yaml.safe_load(text), "--env-kwargs")
    except (yaml.YAMLError, RecursionError):
        raise UsageError(
            f"--env-kwargs must be a YAML table such as '{{a: 1}}', got {validate.shown(text)}."
        ) from None
    except ValueError as error:
        raise UsageError(str(error)) from None


def find_policy(subject: str, trust: bool) -> Policy | None:
    """The stored policy that the subject names; None if it names a controller."""
    if subject in KNOWN:
        return None
    try:
        path = user_path(subject)
        there, is_file = path.exists(), path.is_file()
    except ValueError as error:
        raise UsageError(str(error)) from None
    except OSError as error:
        raise UsageError(f"{subject}: cannot be read ({error.strerror}).") from None
    if not there:
        raise UsageError(
            f"{validate.unknown(subject, 'run or controller', KNOWN)} Give a run's folder, or one "
            f"of {', '.join(KNOWN)}."
        )
    if is_file and path.name not in STORED:
        return load_zip(path, trust=trust)
    return stored_policy(path)[0]


def stored_policy(path: Path) -> tuple[Policy, Path]:
    """The policy of a run's folder, of its own or of a file in it, and this folder."""
    if path.name in STORED:
        path = path.parent
    inside = sorted(found.parent.parent for found in path.glob(f"*/policy/{JSON_FILE}"))
    if inside:
        raise UsageError(
            f"{path}: holds runs, not a policy; name one of them, such as {inside[0]}."
        )
    return load_policy(path), path


def find_env(
    policy: Policy | None, env_id: str | None, kwargs: dict[str, Any] | None
) -> tuple[str, dict[str, Any]]:
    """Environment id and keywords from the command line, by default those of the training.

    With an id on the command line, the keywords of the training do not count. A policy file may
    name only environments of this package, and an arm file as it was; the command line may name
    any, also of a user's module.
    """
    if env_id is not None and ":" in env_id:
        look_in_present_folder()
    about: Mapping[str, Any] = {} if policy is None else policy.about
    own: str = about.get("env_id", "")
    if env_id is None and not own:
        raise UsageError(
            "--env is needed, such as --env FlexArm/OneLink-Reach-v0: a controller names no "
            "environment, and neither does a policy that stores none."
        )
    try:
        if kwargs is None and env_id is None:
            kwargs = check_keywords(about.get("env_kwargs", {}), "about.env_kwargs")
            refuse_other_arm(about, kwargs)
        return registered(own) if env_id is None else env_id, kwargs or {}
    except FolderError:
        raise
    except ValueError as error:
        raise UsageError(
            f"The policy file names an environment that is not allowed: {error}"
        ) from None


def make_controller(
    subject: str, policy: Policy | None, env_id: str, kwargs: dict[str, Any]
) -> tuple[str, Controller]:
    """Name and controller; refuses an environment that is unknown or does not fit the policy."""
    try:
        env = make_batch(env_id, 1, kwargs)
    except REFUSALS as error:
        with_keywords = f" with {validate.shown(kwargs)}" if kwargs else ""
        raise UsageError(f"{env_id}{with_keywords}: {error}") from None
    with closing(env):
        if env.single_observation_space.shape is None:
            raise UsageError(
                f"{env_id} has dicts as observations, with obs='goal'; controllers and stored "
                "policies take one vector: evaluate them on the id without goals."
            )
        if policy is None:
            return subject, classical(subject, env, env_id, kwargs)
        acting_policy = acting(policy, env)
        shapes = (env.single_observation_space.shape, env.single_action_space.shape)
        wanted = ((acting_policy.n_observation,), policy.biases[-1].shape)
        if shapes != wanted:
            trained = policy.about.get("env_kwargs")
            remedy = f" Its training had --env-kwargs {validate.shown(trained)}." if trained else ""
            raise UsageError(
                f"{subject}: takes {wanted[0][0]} observations and gives {wanted[1][0]} actions, "
                f"but {env_id} has {shapes[0][0]} and {shapes[1][0]}.{remedy}"
            )
        refuse_other_observations(subject, policy, env_id, kwargs)
        return one_line(os.path.basename(os.path.abspath(subject))), acting_policy


def refuse_other_observations(
    subject: str, policy: Policy, env_id: str, kwargs: Mapping[str, Any]
) -> None:
    """Raise a UsageError where as many numbers mean other quantities than in the training."""
    try:
        trained = observation_kind(policy.about)
    except ValueError as error:
        raise UsageError(f"{subject}: {error}") from None
    given = observation_kind({"env_id": env_id, "env_kwargs": kwargs})
    if trained != given and trained is not None and given is not None:
        raise UsageError(
            f"{subject}: its training had observations of the kind {trained!r}, but {env_id} with "
            f"{validate.shown(dict(kwargs))} has as many of the kind {given!r}; change --env or "
            "--env-kwargs."
        )


def bounds_of(env_id: str, kwargs: dict[str, Any], seeds: Sequence[int]) -> Controller:
    """Best known torques of episodes of an id with the keywords of a track."""
    track = track_of(OPTIMAL, env_id, kwargs)
    if track is None:
        raise UsageError(
            f"{OPTIMAL} has bounds of ids with the keywords of a track alone, got {env_id} with "
            f"{validate.shown(kwargs)}."
        )
    try:
        return optimal(env_id, track, seeds)
    except ValueError as error:
        raise UsageError(str(error)) from None


def classical(name: str, env: Any, env_id: str, kwargs: dict[str, Any]) -> Controller:
    """A controller of the table: with stored parameters, else joint PD with the best of its grid.

    Parameters are stored for ids with the keywords of a track; elsewhere they must be searched.
    """
    if not CONTROLLERS[name].ranges:
        return controller(name, env)
    track = track_of(name, env_id, kwargs)
    if track is not None and takes_part(name, env_id, track):
        return controller(name, env, parameters_of(name, env_id, track))
    if name == "pd":
        gains = tune_pd(env_id, kwargs)
        return joint_pd(env, gains.frequency_ratio, gains.damping_ratio)
    track = track_of(SENSING, env_id, kwargs)
    there = track and takes_part(SENSING, env_id, track) and is_tuned(SENSING, env_id, track)
    raise UsageError(
        f"{name} was not tuned for {env_id} with {validate.shown(kwargs)}; use "
        f"{f'{SENSING}, which was, or ' if there else ''}pd, whose gains are searched here, or "
        "agents.tune.controllers.tune from Python."
    )


if __name__ == "__main__":
    sys.exit(completed("agents.evaluate", main))
