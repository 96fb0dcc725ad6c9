"""Rigid arms from a table of modified Denavit-Hartenberg parameters.

The convention is that of Cyril's FLEXLINK and of Craig: frame i is fixed to link i with z along
joint i,

    R_i = Rot_x(alpha_{i-1}) Rot_z(theta_i)                                              (2.1)
    O_{i+1} = O_i + a_i x_i + d_{i+1} z_{i+1}                                            (2.2)

so a row's a and alpha lead from its own joint to the next (alpha_0 = a_0 = 0), its d and theta
belong to its own joint, and its frame is at the joint, behind d. Centre of mass and inertia of the
link are given in that frame. The classical convention has the same rows for the same chain of
joints, but places the link frames behind a and alpha: with centres of mass given in those frames,
a table describes another arm.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

from dynamics.description import validate
from dynamics.description.arm import Arm
from dynamics.description.joint import Joint
from dynamics.description.link import Body, Link
from dynamics.description.validate import ZEROS
from dynamics.types import Matrix3, Vector3

_EXACT = 1e-15  # [-] sines and cosines below this are zero: the angle is a multiple of 90 degrees


@dataclass(frozen=True, kw_only=True)
class Row:
    """Table row: a joint and the link behind it."""

    a: float = 0.0  # [m] along x to the next joint's axis
    d: float = 0.0  # [m] along z to the frame; for a prismatic joint, at q = 0
    alpha: float = 0.0  # [rad] about x, from this joint's axis to the next
    theta: float = 0.0  # [rad] about z; for a revolute joint, at q = 0
    type: str = "revolute"  # | "prismatic"
    mass: float  # [kg]
    com: Vector3 = (0.0, 0.0, 0.0)  # [m] centre of mass
    inertia: Matrix3 = ZEROS  # (3, 3) [kg m^2] about the centre of mass

    def __post_init__(self) -> None:
        for name, unit in (("a", "m"), ("d", "m"), ("alpha", "rad"), ("theta", "rad")):
            value = validate.number(getattr(self, name), f"Row.{name}", unit)
            object.__setattr__(self, name, value)
        for name in ("alpha", "theta"):
            validate.radians([getattr(self, name)], f"Row.{name}")


def rows(data: object, where: str) -> tuple[Row, ...]:
    """Build a table from the plain mappings of an arm file."""
    known = [entry.name for entry in fields(Row)]
    result = []
    for k, entry in enumerate(validate.sequence(data, where)):
        values: dict[str, Any] = validate.mapping(entry, f"{where}[{k}]", known)
        if "mass" not in values:
            raise ValueError(f"{where}[{k}].mass is missing.")
        try:
            result.append(Row(**values))
        except ValueError as error:
            raise ValueError(f"{where}[{k}]: {error}") from None
    return tuple(result)


def links(table: Sequence[Row]) -> tuple[Link, ...]:
    """Links of a table: a row's a is the link's length, its mass properties the link's body."""
    if table and table[-1].a < 0.0:
        raise ValueError(
            f"The last row's a must not be negative, got {table[-1].a!r}: it is the last link's "
            "length; turn theta and alpha by 180 degrees."
        )
    return tuple(_link(before, row) for before, row in pairwise([Row(mass=0.0), *table]))


def arm(table: Sequence[Row], **values: Any) -> Arm:
    """Build the arm of a table; `values` are further fields of `Arm` (name, gravity, ...)."""
    return Arm(links=links(table), **values)


def _link(before: Row, row: Row) -> Link:
    ca, sa = _cos_sin(before.alpha)
    ct, st = _cos_sin(row.theta)
    back = min(before.a, 0.0)  # a negative a becomes a joint offset: link lengths are not negative
    return Link(
        length=max(row.a, 0.0),
        body=Body(mass=row.mass, com=row.com, inertia=row.inertia),
        joint=Joint(
            type=row.type,
            rotation=((ct, -st, 0.0), (ca * st, ca * ct, -sa), (sa * st, sa * ct, ca)),
            offset=(back, -sa * row.d, ca * row.d),
        ),
    )


def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, exact where the angle is a multiple of 90 degrees."""
    c, s = math.cos(angle), math.sin(angle)
    if min(abs(c), abs(s)) < _EXACT:
        return float(round(c)), float(round(s))
    return c, s
