"""Convert a robot of a URDF file to an arm.

The frame of a link keeps its origin, at the joint, and gets z along the joint's axis and x towards
the next joint. A rigid link is a body with the mass, the centre and the inertia of the file; links
that are fixed to it belong to it.

A flexible link is a beam from its joint to the next, with the link's mass spread evenly. Where that
line is not perpendicular to the joint's axis, a hub without mass turns, and the beam is fixed to
it. Links that are fixed to a flexible one are fixed to the nearer end of the beam.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.description.arm_file import arm_from_dict
from dynamics.description.link import Body, Link
from dynamics.description.mode_rule import AUTO
from dynamics.description.mode_shapes import STIFFNESS
from dynamics.description.urdf.chain import Part, chain, chosen_tip, left_out, limits_in_words
from dynamics.description.urdf.robot import HERE, Pose, placed, read_robot, together
from dynamics.types import Array

GRAVITY = [0.0, 0.0, -9.81]  # [m/s^2]: z is up in a URDF
FLEXIBLE_KEYS = [x.name for x in fields(Link) if x.name not in ("length", "joint", "body")]
MASS = {"rho_A", "sections"}  # keys of a flexible link, either of which states its mass
END = "tip"  # key of a flexible link that is not one of `Link`
SLIGHT = 0.01  # [-] sine of the angle from which two directions span a plane
PERPENDICULAR = 1e-12  # [-] cosine up to which a beam is perpendicular to its joint's axis
ROUND_OFF = 1e-15  # of an entry of a rotation [-] or of a place [m]

Flexible = Mapping[str, Mapping[str, Any]]  # fields of `Link` by name of a URDF link
Plain = dict[str, Any]  # a link of an arm file


class UrdfWarning(UserWarning):
    """A URDF file states more than its arm has."""


@dataclass(frozen=True)
class Conversion:
    """Arm of a robot."""

    arm: Arm
    sources: tuple[str, ...]  # per link of the arm, the link and the joint that it comes from
    notes: tuple[str, ...]  # what is not taken over


@dataclass
class _Links:
    """Links so far, and the end of the last one in the frame of the last part."""

    data: list[Plain] = field(default_factory=list)
    sources: list[str] = field(default_factory=list)
    end: Pose = HERE

    def add(self, source: str, link: Plain, end: Pose) -> None:
        """Add a link; `end` is that of its tip in the frame of its part."""
        self.data.append(link)
        self.sources.append(source)
        self.end = end


def convert(path: Path, tip: str | None = None, flexible: Flexible | None = None) -> Conversion:
    """Convert the chain from a robot's base to a link.

    Parameters
    ----------
    tip : the link whose origin is the arm's tip; None: the only link without a joint beyond.
    flexible : fields of `Link` by name of a link that is to bend: stiffnesses, damping, modes
        ("auto" unless given). `rho_A` and `rho_Ip`, or `sections`, replace those from the link's
        mass and inertia.
        The key "tip", (3,) [m] in the link's frame, is the end of a last link with no frame there.

    Raises
    ------
    ValueError : if the file, the tip or a flexible link cannot be that of an arm.
    """
    robot = read_robot(path)
    if not isinstance(flexible, Mapping | None):
        raise ValueError(
            'flexible must be a mapping of links to their fields, as {"link_3": {"EIz": 40.0}}, '
            f"got {validate.shown(flexible)}."
        )
    beams = {name: _beam(name, values) for name, values in (flexible or {}).items()}
    end = chosen_tip(robot, tip)
    parts = chain(robot, end, beams)
    _refuse_massless(parts, beams)
    links, notes = _Links(), left_out(robot, end)
    for part, beyond in pairwise([*parts, None]):
        assert part is not None
        if part.name in beams:
            notes.append(_add_beam(links, part, beyond, beams[part.name]))
        else:
            _add_body(links, part, last=beyond is None)
    try:
        arm = arm_from_dict({"name": robot.name, "gravity": GRAVITY, "links": links.data})
    except ValueError as error:
        raise ValueError(_in_the_file(str(error), links.sources)) from None
    return Conversion(arm, tuple(links.sources), tuple(notes))


def _beam(name: str, values: object) -> Plain:
    where = f"flexible[{name!r}]"
    given = validate.mapping(values, where, [*FLEXIBLE_KEYS, END])
    if not {*STIFFNESS.values(), "sections"}.intersection(given):
        raise ValueError(
            f"{where} must have a stiffness, EIz, EIy, GJ [N m^2] or EA [N], or sections."
        )
    if END in given:
        given[END] = validate.vector(given[END], f"{where}: {END}", "m")
    return given


def _refuse_massless(parts: list[Part], beams: Mapping[str, Plain]) -> None:
    """Refuse a joint that moves no mass before the next one: the dynamics would be singular."""
    groups: list[list[Part]] = []  # that move as one at rest
    for part in parts:
        if not part.joint.fixed or not groups:
            groups.append([])
        groups[-1].append(part)
    for group in groups:
        joint = group[0].joint
        heavy = any(body.mass > 0.0 for part in group for body in (part.own, *part.fixed))
        if not (heavy or joint.fixed or any(MASS & {*beams.get(x.name, {})} for x in group)):
            raise ValueError(
                f"link {joint.child!r} behind joint {joint.name!r} must have a mass, got none; "
                "give it an <inertial> with a positive <mass> [kg]."
            )


def _add_body(links: _Links, part: Part, last: bool) -> None:
    """Add a rigid link; the last one's tip is the arm's, by the joint's root."""
    body = together([part.own, *part.fixed])
    if last and part.joint.fixed and not body.mass and not part.end.any():
        return  # a frame at the end of a beam
    axis = np.eye(3)[2] if part.joint.fixed else part.joint.axis
    A = _frame(axis, part.end)
    length = float(part.end @ A[:, 0])
    if length <= SLIGHT * np.linalg.norm(part.end):
        length = 0.0
    root = A.T @ part.end - (length, 0.0, 0.0) if last else np.zeros(3)
    joint = _joint(part, links.end, A) | {"root": _plain(root)}
    inner = placed(body, Pose(A.T, -root))
    link = {"length": length, "body": _body(inner), "joint": joint}
    links.add(_source(part), link, Pose(A, length * A[:, 0]))


def _add_beam(links: _Links, part: Part, beyond: Part | None, given: Plain) -> str:
    """Add a flexible link, and return what it does not keep of the rigid one."""
    values = dict(given)
    end = _end(part, beyond, values.pop(END, None))
    length = float(np.linalg.norm(end))
    x = end / length
    axes = [] if part.joint.fixed else [part.joint.axis]
    if beyond is not None and not beyond.joint.fixed:
        axes.append(beyond.mounting.rotation @ beyond.joint.axis)
    z = _across(x, *axes, *np.eye(3))
    A = np.stack([x, np.cross(z, x), z], axis=1)
    near = [body for body in part.fixed if x @ body.com < 0.5 * length]
    far = [body for body in part.fixed if x @ body.com >= 0.5 * length]
    source, link = _source(part), {"length": length, "modes": AUTO}
    if part.own.mass and "sections" not in given:
        polar = float(x @ np.array(part.own.inertia) @ x)
        link |= {"rho_A": part.own.mass / length, "rho_Ip": max(0.0, polar) / length}
    if not part.joint.fixed and abs(part.joint.axis @ x) > PERPENDICULAR:
        H = _frame(part.joint.axis, end)
        hub = {
            "length": 0.0,
            "body": _body(placed(together(near), Pose(H.T, np.zeros(3)))),
            "joint": _joint(part, links.end, H),
        }
        links.add(f"{source}: hub of a beam that is not perpendicular to the axis", hub, HERE)
        source = f"{part.name}: beam, fixed to the hub"
        link["joint"] = {"type": "fixed", "rotation": _plain(H.T @ A)}
    else:
        if near:
            link["body"] = _body(placed(together(near), Pose(A.T, np.zeros(3))))
        link["joint"] = _joint(part, links.end, A)
    links.add(source, link | values, Pose(A, end))
    if far:
        body = _body(placed(together(far), Pose(A.T, -A.T @ end)))
        weld = {"length": 0.0, "body": body, "joint": {"type": "fixed"}}
        links.add(f"fixed to the tip of {part.name}", weld, links.end)
    return _not_kept(part, length, x, sorted(MASS & {*values}))


def _end(part: Part, beyond: Part | None, given: Any) -> Array:
    """End of a beam [m] in the frame of its link."""
    if given is not None and (beyond is not None or part.end.any()):
        raise ValueError(
            f"flexible[{part.name!r}]: {END} is that of a last link without a frame at its end, "
            f"but this one ends at {part.end.tolist()}; leave {END} out."
        )
    end = part.end if given is None else np.array(given)
    if not end.any():
        raise ValueError(
            f"link {part.name!r} cannot be flexible: it ends where it begins, at joint "
            f"{part.joint.name!r}. Choose as the arm's tip a link at its end, or give "
            f"flexible={{{part.name!r}: {{{END!r}: [x, y, z], ...}}}} [m] in its frame."
        )
    return end


def _not_kept(part: Part, length: float, x: Array, stated: list[str]) -> str:
    com = np.array(part.own.com)
    along = float(x @ com)
    off = float(np.linalg.norm(com - along * x))
    mass = f"the mass of {part.own.mass:g} kg"
    spread = f"{mass} is replaced by {stated[0]}" if stated else f"{mass} is spread evenly"
    return (
        f"link {part.name!r} is a beam of {length:g} m: {spread}, its centre is the beam's (it was "
        f"{along:g} m along it and {off:g} m beside it), and the inertia is the beam's"
    )


def _joint(part: Part, before: Pose, A: Array) -> Plain:
    """Joint of a link whose frame is turned by A against that of the file."""
    at = part.mounting.seen_from(before)
    joint: Plain = {"rotation": _plain(at.rotation @ A), "offset": _plain(at.position)}
    if part.joint.fixed:
        return joint | {"type": "fixed"}
    return joint | {
        "type": "prismatic" if part.joint.type == "prismatic" else "revolute",
        "viscous": part.joint.damping,
        "coulomb": part.joint.friction,
    }


def _frame(axis: Array, towards: Array) -> Array:
    """(3, 3) axes, as columns, of a frame with z along an axis and x towards a point, if it can."""
    x = _across(axis, towards, *np.eye(3))
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _across(axis: Array, *directions: Array) -> Array:
    """(3,) unit vector across an axis, towards the first direction that is not almost along it."""
    for direction in directions:
        part = direction - (direction @ axis) * axis
        size = float(np.linalg.norm(part))
        if size > SLIGHT * np.linalg.norm(direction):
            return np.asarray(part / size)
    raise AssertionError("one of three directions is across")


def _body(body: Body) -> Plain:
    return {
        "mass": body.mass,
        "com": list(body.com),
        "inertia": [list(row) for row in body.inertia],
    }


def _plain(values: Array) -> Any:
    """Lists of numbers, without the round-off of right angles."""
    whole = np.round(values)
    return (np.where(np.abs(values - whole) < ROUND_OFF, whole, values) + 0.0).tolist()


def _in_the_file(sentence: str, sources: list[str]) -> str:
    """A sentence about a link of the arm, with its source in place of its number."""
    return re.sub(r"^links\[(\d+)\]", lambda found: sources[int(found[1])], sentence)


def _source(part: Part) -> str:
    words = limits_in_words(part.joint)
    behind = f"{part.name} behind {part.joint.name} ({part.joint.type})"
    return f"{behind}, limits: {words}" if words else behind
