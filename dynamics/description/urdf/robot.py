"""Read a URDF file: a tree of links with their inertias, and of the joints between them.

The reader is our own, on the XML parser of the standard library: yourdfpy brings 32 further
packages and urchin 15, most of them for meshes, and the last release of urdf_parser_py is of 2021.
A document type is refused, and with it every entity that a file defines. No other file is opened:
meshes, geometry, materials, transmissions and the elements of simulators are not read.
"""

import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from dynamics.description import validate
from dynamics.description.data_file import read_bytes
from dynamics.description.link import Body, about_origin
from dynamics.description.rotations import from_euler, rotation_matrix
from dynamics.description.validate import shown
from dynamics.types import Array

SUFFIX = ".urdf"
MOST_BYTES = 1_048_576
TURNING = ("revolute", "continuous")
TYPES = (*TURNING, "prismatic", "fixed", "floating", "planar")
LIMITS = ("lower", "upper", "velocity", "effort")
DECLARED = re.compile(rb"""(?:\xef\xbb\xbf)?<\?xml[^>]*\sencoding\s*=\s*["']([\w.-]+)["']""")


class Pose(NamedTuple):
    """Place of a frame in another."""

    rotation: Array  # (3, 3) [-] from the frame to the other
    position: Array  # (3,) [m] of its origin

    def __matmul__(self, inner: "Pose") -> "Pose":
        """Place in the outer frame of what is placed in this one."""
        return Pose(self.rotation @ inner.rotation, self.position + self.rotation @ inner.position)

    def seen_from(self, frame: "Pose") -> "Pose":
        """Place in `frame`; both are placed in the same frame."""
        return Pose(
            frame.rotation.T @ self.rotation, frame.rotation.T @ (self.position - frame.position)
        )


HERE = Pose(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class UrdfJoint:
    """Joint and the link behind it."""

    name: str
    type: str  # one of TYPES
    parent: str
    child: str
    origin: Pose  # in the parent's frame, at zero
    axis: Array  # (3,) [-] unit vector in the child's frame
    damping: float  # [N m s/rad], or [N s/m] if prismatic
    friction: float  # [N m], or [N] if prismatic
    limits: dict[str, float]  # those of LIMITS that are given [rad], [rad/s], [N m]; or m, m/s, N
    mimics: bool

    @property
    def fixed(self) -> bool:
        """True if the joint has no coordinate."""
        return self.type == "fixed"


@dataclass(frozen=True)
class Robot:
    """Tree of links and joints."""

    name: str
    links: dict[str, Element]  # by name
    joints: dict[str, UrdfJoint]  # by the link behind
    root: str  # the link without a joint

    @property
    def leaves(self) -> list[str]:
        """Links without a joint beyond them."""
        parents = {joint.parent for joint in self.joints.values()}
        return [name for name in self.links if name not in parents]

    def body(self, link: str) -> Body:
        """Mass properties in the frame of a link; without mass if it states none."""
        where, inertial = f"link {link!r}", self.links[link].find("inertial")
        if inertial is None:
            return Body(mass=0.0)
        mass = _numbers(inertial, "mass", "value", 1, where)[0]
        validate.nonnegative(mass, f"{where}: value of <mass>", "kg")
        entries = inertial.find("inertia")
        xx, xy, xz, yy, yz, zz = (
            0.0 if entries is None else _numbers(inertial, "inertia", f"i{axes}", 1, where)[0]
            for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
        )
        tensor = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
        validate.inertia(tensor, f"{where}: <inertia>")
        return placed(Body(mass=mass, inertia=tensor), _origin(inertial, where))

    def path(self, tip: str) -> list[UrdfJoint]:
        """Joints from the root to a link."""
        result: list[UrdfJoint] = []
        while tip != self.root:
            result.append(self.joints[tip])
            tip = self.joints[tip].parent
        return result[::-1]

    def outward(self) -> Iterator[UrdfJoint]:
        """All joints, each after that of its parent."""
        beyond: dict[str, list[UrdfJoint]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            beyond[joint.parent].append(joint)
        waiting = [self.root]
        for name in waiting:
            yield from beyond[name]
            waiting += [joint.child for joint in beyond[name]]


def read_robot(path: Path) -> Robot:
    """Read a URDF file.

    Raises
    ------
    ValueError : if the file cannot be read or is not a tree of links; one sentence with the reason.
    """
    text = _decoded(read_bytes(path, MOST_BYTES))
    if "<!DOCTYPE" in text:
        raise ValueError(
            "must not contain a document type (<!DOCTYPE ...>), with which a file may define "
            "entities; remove it."
        )
    try:
        top = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"is not valid XML: {error}.") from None
    if top.tag != "robot":
        raise ValueError(f"must hold a <robot> at the top, got <{top.tag[:60]}>.")
    for element in top.iter():
        if "xacro}" in element.tag:
            raise ValueError(
                f"holds the macro <xacro:{element.tag.partition('}')[2][:60]}>; expand it first: "
                "xacro FILE > robot.urdf."
            )
    return _tree(top)


def _decoded(content: bytes) -> str:
    """Text of an XML file in the encoding that its byte order mark or its first line declares."""
    declared = DECLARED.match(content)
    encoding = declared[1].decode() if declared else "utf-8-sig"
    if content.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        encoding = "utf-16"
    try:
        return content.decode(encoding)
    except LookupError:
        raise ValueError(f"declares the unknown encoding {encoding!r}; save it as UTF-8.") from None
    except UnicodeError as error:
        raise ValueError(
            f"must be text in {encoding} ({error}); save it as UTF-8, or declare its encoding in "
            '<?xml version="1.0" encoding="ISO-8859-1"?>.'
        ) from None


def together(bodies: list[Body]) -> Body:
    """Rigid body of several, all in the same frame."""
    if len(bodies) == 1:
        return bodies[0]
    mass = sum(body.mass for body in bodies)
    moment = sum((body.mass * np.array(body.com) for body in bodies), np.zeros(3))
    com: Any = moment / mass if mass > 0.0 else moment
    inertia: Any = sum((about_origin(body) for body in bodies), np.zeros((3, 3)))
    inertia = inertia - mass * ((com @ com) * np.eye(3) - np.outer(com, com))
    return Body(mass=mass, com=com, inertia=inertia)


def placed(body: Body, pose: Pose) -> Body:
    """A body of a frame, in the frame in which that one has this pose."""
    R = pose.rotation
    return Body(
        mass=body.mass,
        com=pose.position + R @ np.array(body.com),
        inertia=R @ np.array(body.inertia) @ R.T,
    )


def _tree(top: Element) -> Robot:
    links: dict[str, Element] = {}
    for element in top.findall("link"):
        name = _name(element, "link")
        if links.setdefault(name, element) is not element:
            raise ValueError(f"the link {name!r} stands twice; keep one.")
    joints: dict[str, UrdfJoint] = {}
    for element in top.findall("joint"):
        joint = _joint(element, links)
        other = joints.setdefault(joint.child, joint)
        if other is not joint:
            raise ValueError(
                f"the link {joint.child!r} is the child of two joints, {other.name!r} and "
                f"{joint.name!r}; an arm is a tree, keep one."
            )
    roots = [name for name in links if name not in joints]
    if len(roots) != 1:
        raise ValueError(f"must have one link that is no joint's child, got {shown(roots)}.")
    name = top.get("name", "")
    robot = Robot(name if name.isprintable() else "", links, joints, roots[0])
    loose = set(joints) - {joint.child for joint in robot.outward()}
    if loose:
        raise ValueError(f"the joints of the links {shown(sorted(loose))} form a circle.")
    return robot


def _joint(element: Element, links: Collection[str]) -> UrdfJoint:
    name = _name(element, "joint")
    where = f"joint {name!r}"
    kind = validate.choice(element.get("type"), f"{where}: type", TYPES)
    ends = {}
    for end in ("parent", "child"):
        found = element.find(end)
        link = None if found is None else found.get("link")
        if link is None or link not in links:
            raise ValueError(f"{where}: <{end}> must name a link of the file, got {shown(link)}.")
        ends[end] = link
    axis = np.array(_numbers(element, "axis", "xyz", 3, where, (1.0, 0.0, 0.0)))
    size = float(np.linalg.norm(axis))
    if kind != "fixed" and not size > 1e-6:
        raise ValueError(f"{where}: <axis> must not be zero, got {axis.tolist()}.")
    losses = {}
    for key, unit in (("damping", "N m s/rad"), ("friction", "N m")):
        value = _numbers(element, "dynamics", key, 1, where, (0.0,))[0]
        losses[key] = validate.nonnegative(value, f"{where}: {key} of <dynamics>", unit)
    limit = element.find("limit")
    given = () if limit is None else (name for name in LIMITS if name in limit.attrib)
    return UrdfJoint(
        name=name,
        type=kind,
        parent=ends["parent"],
        child=ends["child"],
        origin=_origin(element, where),
        axis=axis / size if size > 0.0 else axis,
        damping=losses["damping"],
        friction=losses["friction"],
        limits={key: _numbers(element, "limit", key, 1, where)[0] for key in given},
        mimics=element.find("mimic") is not None,
    )


def _origin(element: Element, where: str) -> Pose:
    zeros = (0.0, 0.0, 0.0)
    roll, pitch, yaw = _numbers(element, "origin", "rpy", 3, where, zeros)
    validate.radians((roll, pitch, yaw), f"{where}: rpy of <origin>")
    rotation = rotation_matrix(from_euler((yaw, pitch, roll)))
    return Pose(np.array(rotation), np.array(_numbers(element, "origin", "xyz", 3, where, zeros)))


def _name(element: Element, kind: str) -> str:
    """Name of a link or joint: printable, as it goes into messages and comments."""
    name = element.get("name")
    if not name or not name.isprintable():
        raise ValueError(f"every <{kind}> must have a printable name, got {shown(name)}.")
    return name


def _numbers(
    element: Element,
    tag: str,
    key: str,
    count: int,
    where: str,
    default: tuple[float, ...] | None = None,
) -> tuple[float, ...]:
    """Numbers of an attribute of a child element."""
    child = element.find(tag)
    text = None if child is None else child.get(key)
    if text is None and default is not None:
        return default
    what = f"{where}: {key} of <{tag}>"
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count:
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise ValueError(f"{what} must be {wanted}, got {shown(text)}.")
    return tuple(validate.number(value, what) for value in values)
