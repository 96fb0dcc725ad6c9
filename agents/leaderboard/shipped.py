"""Trained policies that come with the package: agents/policies/TASK/TRACK/ALGORITHM/seedN."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from agents.config import Config, ConfigError, load_config
from agents.experiments import shipped_experiments
from agents.leaderboard.tracks import TRACKS, designed_for, is_spread, track_of
from agents.policy import Policy, load_policy, save_policy
from dynamics.description import validate
from dynamics.description.data_file import user_path

FOLDER = Path(__file__).parents[1] / "policies"
LINKS = {"residual": "on", "advised": "advised-by", "alone": "watching", "reference": "ahead-of"}
LINKS |= {"distilled": "of"}


def name_of(policy: Policy) -> str:
    """Algorithm of a policy, with its base, "-warm", "-stacked", "-recurrent" and "-spread"."""
    about = policy.about
    base = about.get("base", about.get("expert"))
    return ranked_as(
        about.get("algorithm", "policy"), base, policy.stack, policy.recurrent > 0,
        bool(about.get("warm_start")),
        is_spread(about.get("env_id", ""), about.get("env_kwargs", {})),
    )  # fmt: skip


def name_made_by(config: Config) -> str:
    """Name of the policies that an experiment makes."""
    agent, env, base = config.agent, config.env, config.to_dict().get("base")
    spread = is_spread(env.id, env.kwargs)
    recurrent = agent.policy == "MlpLstmPolicy"
    return ranked_as(agent.name, base, env.stack, recurrent, bool(agent.warm_start), spread)


def ranked_as(
    algorithm: str,
    base: Mapping[str, Any] | None,
    stack: int,
    recurrent: bool,
    warm: bool,
    spread: bool,
) -> str:
    """Algorithm with the base on which the policy acts, such as "-on-lqg", and how it was made."""
    named = recurrent and not algorithm.startswith("recurrent")
    how = "-warm" * warm + "-stacked" * (stack > 1) + "-recurrent" * named + "-spread" * spread
    return algorithm + on_base(base) + how


def on_base(base: Mapping[str, Any] | None) -> str:
    """Part of a name that tells the base of a policy; empty without one."""
    return "" if base is None else f"-{LINKS[base['learned']]}-{base['controller']}"


def place(env_id: str, track: str) -> Path:
    """Folder of a task's policies for a track."""
    return FOLDER / env_id.split("/")[1] / track


def ship(policy: Policy, env_id: str, track: str) -> None:
    """Store a policy among those of the package."""
    seed = policy.about.get("seed", 0)
    save_policy(policy, place(env_id, track) / name_of(policy) / f"seed{seed}")


def shipped(env_id: str, track: str) -> dict[str, list[Policy]]:
    """Policies of a task and track: one per training seed, by name."""
    return {name: policies.copy() for name, policies in loaded(env_id, track).items()}


@cache
def loaded(env_id: str, track: str) -> dict[str, list[Policy]]:
    """The policies themselves, which `shipped` copies: files are read once."""
    validate.known(track, "track", TRACKS)
    found: dict[str, list[Policy]] = {}
    for folder in sorted(place(designed_for(env_id), track).glob("*/seed*")):
        found.setdefault(folder.parent.name, []).append(load_policy(folder))
    return found


def policies_of(env_id: str, track: str) -> dict[str, list[Policy]]:
    """Policies that act on a track: those of its design conditions, and those trained for it."""
    return shipped(env_id, TRACKS[track].design) | shipped(env_id, track)


def shipped_policies(config: Config) -> list[Policy]:
    """Policies that an experiment made, one per training seed; none if it is not shipped."""
    env = config.env
    track = track_of(config.agent.name, env.id, env.kwargs)
    return [] if track is None else shipped(env.id, track).get(name_made_by(config), [])


def named_policy(name: str, seed: int) -> Policy:
    """The policy in a run's folder, or that of a shipped experiment, if possible of this seed.

    Raises
    ------
    ConfigError : for a name without a policy.
    """
    known = shipped_experiments()
    if name not in known:
        try:
            return load_policy(user_path(name))
        except ValueError as error:
            raise ConfigError(
                f"agent.warm_start: neither a run nor a shipped experiment: {error}"
            ) from None
    found = shipped_policies(load_config(known[name]))
    if not found:
        raise ConfigError(
            f"agent.warm_start: no policy of {name} is shipped; train it and give its run's folder."
        )
    return next((x for x in found if x.about.get("seed") == seed), found[0])
