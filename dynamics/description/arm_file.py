"""Build an arm from the plain data of an arm file; `Arm.to_dict` is the inverse."""

import warnings
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

from dynamics.description import denavit_hartenberg, mode_rule, validate
from dynamics.description.arm import MOST_LINKS, Arm, Base
from dynamics.description.beams.sections import MOST_SECTIONS, Section
from dynamics.description.joint import Joint
from dynamics.description.link import MOST_MODES, Body, Link, Payload
from dynamics.description.mode_shapes import Mode
from dynamics.description.plausibility import warn_if_implausible
from dynamics.description.rotations import from_euler

TABLE = "denavit_hartenberg"  # key that replaces links by table rows, see that module
ARM_KEYS = (*(entry.name for entry in fields(Arm)), "units", TABLE)
CASE_KEYS = (  # further keys of an arm file: a motion and its reference results
    "initial",
    "torque",
    "t_end",
    "n_out",
    "states",
    "expected",
    "conventions",
    "checks",
)


def arm_from_dict(data: Mapping[str, Any]) -> Arm:
    """Build an arm from plain lists, numbers and text; unknown keys raise ValueError.

    A link with a stiffness and without the key `modes` is rigid, with a RigidLinkWarning. Numbers
    of no arm, as lengths in mm, give an ImplausibleArmWarning, thick links a ThickLinkWarning.
    """
    arm = _arm(data)
    warn_if_implausible(arm, stacklevel=3)
    return arm


def _arm(data: Mapping[str, Any]) -> Arm:
    keys = validate.mapping(data, "the arm", (*ARM_KEYS, *CASE_KEYS))
    validate.choice(keys.get("units", "SI"), "units", ("SI",))
    values = {key: keys[key] for key in ARM_KEYS if key in keys and key not in ("units", TABLE)}
    if values.get("base") is not None:
        values["base"] = _base(values["base"])
    else:
        values.pop("base", None)
    if values.get("payload") is not None:
        values["payload"] = _build(Payload, values["payload"], "payload")
    if TABLE in keys:
        if "links" in keys:
            raise ValueError(f"links and {TABLE} exclude each other; give one.")
        values["links"] = denavit_hartenberg.links(denavit_hartenberg.rows(keys[TABLE], TABLE))
        return Arm(**values)  # type: ignore[arg-type]
    links = validate.sequence(values.get("links", []), "links", MOST_LINKS)
    values["links"] = [_link(entry, f"links[{i}]") for i, entry in enumerate(links)]
    return Arm(**values)  # type: ignore[arg-type]


def _link(data: object, where: str) -> Link:
    values = validate.mapping(data, where, [entry.name for entry in fields(Link)])
    if "joint" in values:
        values["joint"] = _build(Joint, values["joint"], f"{where}.joint")
    if values.get("body") is not None:
        values["body"] = _build(Body, values["body"], f"{where}.body")
    if "sections" in values:
        sections = validate.sequence(values["sections"], f"{where}.sections", MOST_SECTIONS)
        values["sections"] = [
            _build(Section, s, f"{where}.sections[{k}]") for k, s in enumerate(sections)
        ]
    silent = "modes" not in values
    if silent:
        values["modes"] = []
    elif not isinstance(mode_rule.listed(values["modes"], f"{where}: Link.modes"), str):
        modes = validate.sequence(values["modes"], f"{where}.modes", MOST_MODES)
        values["modes"] = [_build(Mode, m, f"{where}.modes[{j}]") for j, m in enumerate(modes)]
    link: Link = _build(Link, values, where)
    if silent and link.stiffnesses:
        sentence = mode_rule.rigid_in_silence(where, link.stiffnesses)
        warnings.warn(sentence, mode_rule.RigidLinkWarning, stacklevel=6)
    return link


def _base(data: object) -> Base:
    """Build a base; `euler` (theta about 3, phi about 2, psi about 1) may replace quaternion."""
    names = [entry.name for entry in fields(Base)]
    values = validate.mapping(data, "base", [*names, "euler"])
    if "euler" in values:
        if "quaternion" in values:
            raise ValueError("base: euler and quaternion exclude each other; give one.")
        angles = validate.vector(values.pop("euler"), "base.euler", "rad")
        validate.radians(angles, "base.euler")
        values["quaternion"] = from_euler(angles)
    base: Base = _build(Base, values, "base")
    return base


def _build(cls: Any, data: object, where: str) -> Any:
    """Build a description from a mapping; errors start with its location in the file."""
    values = validate.mapping(data, where, [entry.name for entry in fields(cls)])
    for entry in fields(cls):
        required = entry.default is MISSING and entry.default_factory is MISSING
        if required and entry.name not in values:
            raise ValueError(f"{where}: {cls.__name__}.{entry.name} is missing.")
    try:
        return cls(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
