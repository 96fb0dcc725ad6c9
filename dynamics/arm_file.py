"""Arm files: JSON, YAML or a plain dict into an `Arm`, and back by `Arm.to_dict`."""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from dynamics import checks, denavit_hartenberg
from dynamics.arm import MOST_LINKS, MOST_MODES, Arm, Base, Body, Joint, Link, Mode, Payload
from dynamics.arms import ARMS
from dynamics.attitude import from_euler
from dynamics.data_file import read_mapping

TABLE = "denavit_hartenberg"  # instead of links: rows of a table, see that module
ARM_KEYS = (*(entry.name for entry in fields(Arm)), "units", TABLE)
CASE_KEYS = (  # what an arm file may hold besides the arm: a motion and what is known of it
    "initial",
    "torque",
    "t_end",
    "n_out",
    "states",
    "expected",
    "conventions",
    "checks",
)

ArmSource = str | PathLike[str] | Mapping[str, Any] | Arm  # what `load_arm` takes


def load_arm(source: ArmSource) -> Arm:
    """An arm from a preset's name, a path (.json, .yaml, .yml), a dict, or itself.

    A case file is an arm file too: its motion and expectations are left aside.
    """
    if isinstance(source, Arm):
        return source
    if isinstance(source, Mapping):
        return arm_from_dict(source)
    if isinstance(source, str) and source in ARMS:
        return ARMS[source]
    if not isinstance(source, str | PathLike):
        raise ValueError(
            f"An arm is a preset name, a path, a dict or an Arm, got {type(source).__name__}."
        )
    path = Path(fspath(source))
    if isinstance(source, str) and path.suffix == "":
        raise ValueError(
            f"Unknown arm {checks.shown(source)}. Presets: {sorted(ARMS)}; or give the path of a "
            ".json or .yaml file."
        )
    try:
        return arm_from_dict(read_mapping(path))
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def arm_from_dict(data: Mapping[str, Any]) -> Arm:
    """An arm from plain lists, numbers and text; every unknown key is refused."""
    keys = checks.mapping(data, "the arm", (*ARM_KEYS, *CASE_KEYS))
    if keys.get("units", "SI") != "SI":
        raise ValueError(f'units must be "SI", got {checks.shown(keys["units"])}.')
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
        values["links"] = denavit_hartenberg.links(denavit_hartenberg.rows(keys[TABLE]))
        return Arm(**values)  # type: ignore[arg-type]
    links = checks.sequence(values.get("links", []), "links", MOST_LINKS)
    values["links"] = [_link(entry, f"links[{i}]") for i, entry in enumerate(links)]
    return Arm(**values)  # type: ignore[arg-type]


def _link(data: object, where: str) -> Link:
    values = checks.mapping(data, where, [entry.name for entry in fields(Link)])
    if "joint" in values:
        values["joint"] = _build(Joint, values["joint"], f"{where}.joint")
    if values.get("body") is not None:
        values["body"] = _build(Body, values["body"], f"{where}.body")
    if "modes" in values:
        modes = checks.sequence(values["modes"], f"{where}.modes", MOST_MODES)
        values["modes"] = [_build(Mode, m, f"{where}.modes[{j}]") for j, m in enumerate(modes)]
    link: Link = _build(Link, values, where)
    return link


def _base(data: object) -> Base:
    """A base; 3-2-1 Euler angles (theta about 3, phi about 2, psi about 1) may stand for it."""
    names = [entry.name for entry in fields(Base)]
    values = checks.mapping(data, "base", [*names, "euler"])
    if "euler" in values:
        if "quaternion" in values:
            raise ValueError("base: euler and quaternion exclude each other; give one.")
        angles = checks.vector(values.pop("euler"), "base.euler", "rad")
        values["quaternion"] = from_euler(angles)
    base: Base = _build(Base, values, "base")
    return base


def _build(cls: Any, data: object, where: str) -> Any:
    """A description from a mapping; errors say where in the file it stands."""
    values = checks.mapping(data, where, [entry.name for entry in fields(cls)])
    for entry in fields(cls):
        required = entry.default is MISSING and entry.default_factory is MISSING
        if required and entry.name not in values:
            raise ValueError(f"{where}: {cls.__name__}.{entry.name} is missing.")
    try:
        return cls(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
