"""Chain of a robot from its base to a tip: the parts that bend or move as one, and what is left."""

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from dynamics.description import validate
from dynamics.description.link import Body
from dynamics.description.urdf.robot import HERE, LIMITS, TURNING, Pose, Robot, UrdfJoint, placed
from dynamics.types import Array


@dataclass
class Part:
    """Link behind a joint of the chain, and the links that are fixed to it, in its frame."""

    joint: UrdfJoint
    mounting: Pose  # of the joint at zero, in the frame of the part before
    own: Body  # of the link itself
    fixed: list[Body] = field(default_factory=list)  # of the links that are fixed to it
    end: Array = field(default_factory=lambda: np.zeros(3))  # (3,) [m] next part's joint, or tip

    @property
    def name(self) -> str:
        """Name of the link."""
        return self.joint.child


def chosen_tip(robot: Robot, tip: str | None) -> str:
    """The link at which the chain ends."""
    if tip is not None:
        return validate.known(tip, "tip", robot.links)
    if len(robot.leaves) > 1:
        raise ValueError(
            f"the tree has several ends, and an arm has one; choose it, tip=LINK. Ends: "
            f"{sorted(robot.leaves)}."
        )
    return robot.leaves[0]


def chain(robot: Robot, tip: str, flexible: Collection[str]) -> list[Part]:
    """Parts from the base to the tip.

    A part begins at every joint that moves, and at both ends of a flexible link. Links beside the
    chain are fixed to their part, joints between them at zero.
    """
    path = robot.path(tip)
    behind = [joint.child for joint in path]
    for name in flexible:
        if name in robot.links and name not in behind:
            raise ValueError(
                f"the flexible link {name!r} is not behind a joint between {robot.root!r} and "
                f"{tip!r}. Links that are: {behind}."
            )
        validate.known(name, "flexible link", behind)
    parts: dict[str, Part] = {}
    where = {robot.root: (robot.root, HERE)}  # part and place in it, of every link
    for joint in robot.outward():
        name, pose = where[joint.parent]
        at = pose @ joint.origin
        begins = not joint.fixed or joint.child in flexible or joint.parent in flexible
        if begins and joint.child in behind:
            _check(joint)
            parts[joint.child] = Part(joint, at, robot.body(joint.child))
            where[joint.child] = (joint.child, HERE)
            if name in parts:
                parts[name].end = at.position
        else:
            where[joint.child] = (name, at)
            if name in parts:
                parts[name].fixed += _massive(placed(robot.body(joint.child), at))
    if not flexible and all(part.joint.fixed for part in parts.values()):
        raise ValueError(
            f"no joint between {robot.root!r} and {tip!r} moves; choose another tip. Links: "
            f"{sorted(robot.links)}."
        )
    last, at = where[tip]
    parts[last].end = at.position
    return list(parts.values())


def left_out(robot: Robot, tip: str) -> list[str]:
    """Sentences about what an arm does not take over from a robot."""
    path = robot.path(tip)
    result, behind = [], {joint.child for joint in path}
    held = [j.name for j in robot.outward() if j.child not in behind and not j.fixed]
    if held:
        result.append(f"the joints {held} are beside the chain to {tip!r}; they are held at zero")
    limited = [joint.name for joint in path if not joint.fixed and joint.limits]
    if limited:
        result.append(
            f"the limits of {limited}: an arm has none; efforts may be an environment's "
            "torque_limit"
        )
    return result


def limits_in_words(joint: UrdfJoint) -> str:
    """Limits of a joint with their units, as a comment."""
    turns = joint.type in TURNING
    angle, force = ("rad", "N m") if turns else ("m", "N")
    units = dict(zip(LIMITS, (angle, angle, f"{angle}/s", force), strict=True))
    return ", ".join(f"{key} {value:g} {units[key]}" for key, value in joint.limits.items())


def _massive(body: Body) -> list[Body]:
    """The body, unless it is a frame alone."""
    return [body] if body.mass or any(map(any, body.inertia)) else []


def _check(joint: UrdfJoint) -> None:
    """Refuse a joint of the chain that an arm cannot have."""
    if joint.type in ("floating", "planar"):
        raise ValueError(
            f"joint {joint.name!r}: a {joint.type} joint has several coordinates; an arm's joints "
            "are revolute, continuous, prismatic or fixed. Choose a tip before it, split it, or "
            "make it fixed."
        )
    if joint.mimics:
        raise ValueError(
            f"joint {joint.name!r}: a joint that mimics another has no torque of its own, which an "
            "arm's joints have. Choose a tip before it, or remove <mimic>."
        )
