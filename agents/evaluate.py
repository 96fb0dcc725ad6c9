"""`python -m agents.evaluate RUN_OR_CONTROLLER --env ID`: judge anything that acts, headlessly."""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import yaml

from agents.controllers import CONTROLLERS
from agents.evaluation import make_batch
from agents.policy import Controller, Policy, PolicyError, load_policy, load_zip
from agents.report import compare
from agents.runs import versions


class UsageError(ValueError):
    """A command line that cannot be carried out; the message is one sentence for the user."""


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit status 2 and one sentence for anything that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m agents.evaluate", description=__doc__)
    parser.add_argument(
        "subject",
        metavar="RUN_OR_CONTROLLER",
        help=f"a run's folder, or one of {', '.join(sorted(CONTROLLERS))}",
    )
    parser.add_argument("--env", metavar="ID", help="environment id (a run's own)")
    parser.add_argument("--env-kwargs", metavar="YAML", help="e.g. '{obs: sensors}' (a run's own)")
    parser.add_argument("--episodes", type=int, default=100, metavar="N")
    parser.add_argument("--seed", type=int, default=10_000, metavar="S", help="first of N seeds")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--trust", action="store_true", help="allow unpickling an SB3 zip")
    a = parser.parse_args(arguments)
    try:
        if a.episodes < 1 or a.seed < 0:
            raise UsageError("--episodes must be positive and --seed must not be negative.")
        prepare_folder(a.out)
        env_kwargs = parse_kwargs(a.env_kwargs)
        policy = find_policy(a.subject, a.trust)
        env_id, kwargs = find_env(policy, a.env, env_kwargs)
        name, controller = make_controller(a.subject, policy, env_id, kwargs, a.seed)
        compare(
            {name: controller},
            env_id,
            kwargs,
            episodes=a.episodes,
            seed=a.seed,
            folder=a.out,
            about={"subject": a.subject, "versions": versions()["packages"]},
        )
    except (UsageError, PolicyError, gym.error.Error) as error:
        sentence = " ".join(str(error).split())
        print(f"agents.evaluate: {sentence}", file=sys.stderr)
        return 2
    print(f"Everything is in {a.out}/")
    return 0


def prepare_folder(folder: Path) -> None:
    """The folder to write to, checked before anything runs."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UsageError(f"--out {folder}: cannot be written to ({error.strerror}).") from None


def parse_kwargs(text: str | None) -> dict[str, Any] | None:
    """Keywords of the environment from one line of YAML."""
    if text is None:
        return None
    try:
        kwargs = yaml.safe_load(text)
    except yaml.YAMLError:
        kwargs = None
    if not isinstance(kwargs, dict) or not all(isinstance(key, str) for key in kwargs):
        raise UsageError(f"--env-kwargs must be a YAML table such as '{{a: 1}}', got {text!r}.")
    return kwargs


def find_policy(subject: str, trust: bool) -> Policy | None:
    """The stored policy that the subject names; None if it names a controller."""
    if subject in CONTROLLERS:
        return None
    path = Path(subject)
    if not path.exists():
        raise UsageError(
            f"{subject!r} is neither a run's folder nor a controller; "
            f"controllers: {', '.join(sorted(CONTROLLERS))}."
        )
    return load_policy(path) if path.is_dir() else load_zip(path, trust=trust)


def find_env(
    policy: Policy | None, env_id: str | None, kwargs: dict[str, Any] | None
) -> tuple[str, dict[str, Any]]:
    """What was asked for on the command line, else what the policy was trained on."""
    about: Mapping[str, Any] = {} if policy is None else policy.about
    if env_id is None and about.get("env_id") is None:
        raise UsageError("--env is needed: this subject does not say what it was made for.")
    if kwargs is None:
        same = env_id in (None, about.get("env_id"))
        kwargs = dict(about.get("env_kwargs", {})) if same else {}
    return env_id or about["env_id"], kwargs


def make_controller(
    subject: str, policy: Policy | None, env_id: str, kwargs: dict[str, Any], seed: int
) -> tuple[str, Controller]:
    """Name and controller, once its environment is known to exist and to fit."""
    try:
        env = make_batch(env_id, 1, kwargs)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{env_id} with {kwargs}: {error}") from None
    try:
        if policy is None:
            return subject, CONTROLLERS[subject](env, env_id, kwargs, seed)
        shapes = (env.single_observation_space.shape, env.single_action_space.shape)
        wanted = (policy.observation_low.shape, policy.biases[-1].shape)
        if shapes != wanted:
            raise UsageError(
                f"{subject}: takes {wanted[0][0]} observations and gives {wanted[1][0]} actions, "
                f"but {env_id} has {shapes[0][0]} and {shapes[1][0]}."
            )
        return Path(subject).name, policy
    finally:
        env.close()


if __name__ == "__main__":
    sys.exit(main())
