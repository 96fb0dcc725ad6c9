"""Kinds of controllers, by what they hold and by what their networks take."""

from typing import Any

import pytest

from agents.controllers import CONTROLLERS, controller
from agents.leaderboard.kinds import CLASSICAL, LEARNED, ON_MODEL, needs
from agents.leaderboard.shipped import shipped
from agents.leaderboard.tracks import keywords
from agents.metrics import make_batch
from dynamics.model import Model

REACH = "FlexArm/OneLink-Reach-v0"


def holds_a_model(thing: Any, met: set[int]) -> bool:
    """True if a model of an arm is among the attributes of an object, or among theirs."""
    if id(thing) in met:
        return False
    met.add(id(thing))
    parts = thing if isinstance(thing, list | tuple) else getattr(thing, "__dict__", {}).values()
    return isinstance(thing, Model) or any(holds_a_model(part, met) for part in parts)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_controllers_with_a_model_are_those_that_hold_one(name: str) -> None:
    track = "state" if "state" in CONTROLLERS[name].obs else "laboratory"
    env = make_batch(REACH, 1, keywords(name, track))
    assert holds_a_model(controller(name, env), set()) == CONTROLLERS[name].model
    assert needs(name, REACH, track) == {"kind": CLASSICAL, "base": None}
    env.close()


@pytest.mark.parametrize("track", ["state", "laboratory"])
def test_policies_on_a_model_are_those_that_take_more_than_the_observation(track: str) -> None:
    env = make_batch(REACH, 1, keywords("ppo", track))
    (size,) = env.single_observation_space.shape
    env.close()
    policies = shipped(REACH, track)
    assert len(policies) >= 3
    for name, (policy, *_) in policies.items():
        kind = needs(name, REACH, track)["kind"]
        assert kind == (ON_MODEL if policy.n_observation > size else LEARNED), name


def test_policies_have_the_base_of_their_names() -> None:
    for name, base in (("ppo-ahead-of-pd", "pd"), ("ppo", None)):
        assert needs(name, REACH, "state") == {"kind": LEARNED, "base": base}
    watching = {"kind": ON_MODEL, "base": "lqg"}
    assert needs("ppo-watching-lqg", REACH, "transfer") == watching  # trained in the laboratory


@pytest.mark.parametrize("name", ["optimal", "my:Own", "ppo-older"])
def test_what_is_none_of_ours_has_no_kind(name: str) -> None:
    assert needs(name, REACH, "state") == {"kind": None, "base": None}
