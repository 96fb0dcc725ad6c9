"""Events: what happens once in an episode, unannounced; the keyword `event`.

Time, size and signs are drawn at every reset from the environment's own stream. No observation
shows an event ahead, or the payload. `compiled.happening` traces them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from dynamics.description import validate
from dynamics.description.arm import Arm
from flexarm_env.task.scales import EXTENT

Range = tuple[float, float]
PAYLOAD = "payload_mass"
TIME: Range = (0.5, 2.5)  # [move times] since the start of the episode
PUSHED = 0.1  # [move times] duration of a push


@dataclass(frozen=True, kw_only=True)
class Event:
    """An event, which happens at the start of a control step."""

    text: str  # for the pages
    size: Range  # drawn uniformly


_SHARE, _JUMP, _PUSH = (0.25, 0.5), (0.3, 0.8), (0.3, 0.6)
EVENTS = {
    "drop": Event(
        text=(
            "The arm lets go of its drawn payload, which goes on at the velocity of the tip: "
            "coordinates and rates do not jump. A payload that the arm describes stays. Drawn: "
            f"{_SHARE[0]:g} to {_SHARE[1]:g} of the mass of the last link with its tip; ranges "
            "of `hardware` and `randomize` replace it"
        ),
        size=_SHARE,
    ),
    "jump": Event(
        text=(
            "The target angle of every joint, in Track the centre of its path, jumps by "
            f"{_JUMP[0]:g} to {_JUMP[1]:g} rad, either way; back where it would be more than "
            f"{EXTENT:g} rad from the home posture"
        ),
        size=_JUMP,
    ),
    "push": Event(
        text=(
            "A constant force pushes the tip across the bent last link, either way, for "
            f"{PUSHED:g} move times, in whole control steps. Impulse: {_PUSH[0]:g} to "
            f"{_PUSH[1]:g} of that which gives the arm, as a rigid body about its first joint, "
            "the rate scale"
        ),
        size=_PUSH,
    ),
}


def check_event(name: str | None, arm: Arm) -> None:
    """Refuse an event that is unknown, or a jump of joint angles that do not place the target."""
    if name is None:
        return
    validate.known(name, "event", EVENTS)
    if name == "jump" and arm.base.n:
        raise ValueError(
            f"event must be one of {sorted(set(EVENTS) - {name})} where Base.type is "
            f"{arm.base.type!r}, got {name!r}: joint angles alone do not place the target there."
        )
    if name == "drop" and not payload(arm, EVENTS[name].size)[1]:
        raise ValueError(
            "event 'drop' needs a last link with a mass, of which the payload is a share."
        )


def payload(arm: Arm, shares: Range) -> Range:
    """Range [kg] of a payload from shares of the mass of the last link with tip and body."""
    last = arm.links[-1]
    mass = last.beam.line_mass.mass + last.tip_mass + (last.body.mass if last.body else 0.0)
    return mass * shares[0], mass * shares[1]


def spread(name: str | None, arm: Arm) -> dict[str, Range]:
    """Ranges of drawn parameters of an arm with an event, as the keyword `randomize` takes them."""
    return {PAYLOAD: payload(arm, EVENTS[name].size)} if name == "drop" else {}


def met(name: str | None, ranges: Mapping[str, Range]) -> dict[str, Range]:
    """Ranges of the parameters in whole episodes, from those drawn at a reset."""
    if name != "drop":
        return dict(ranges)
    return {**ranges, PAYLOAD: (0.0, ranges[PAYLOAD][1])}
