"""An arm described anew with values of free parameters."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from dynamics.description.arm import Arm
from dynamics.description.beams.sections import Section
from dynamics.description.link import Link, Payload
from dynamics.description.mode_shapes import STIFFNESS


def with_parameters(arm: Arm, values: Mapping[str, float]) -> Arm:
    """The arm whose description holds what compiled code takes as FREE_PARAMETERS.

    Shapes of modes are those of the new description: a payload does not change them, nor does a
    factor on every stiffness.
    """
    left = dict(values)
    stiffness, damping, friction = (left.pop(x, 1.0) for x in ("stiffness", "damping", "friction"))
    mass = left.pop("payload_mass", None)
    links = [_scaled(link, stiffness, damping, friction) for link in arm.links]
    for name, added in left.items():
        word, joint = name.rsplit("_", 1)
        if int(joint) > arm.n_joint:
            raise ValueError(
                f"{name} is of no joint: this arm has {arm.n_joint} joints, counted from 1."
            )
        k = arm.joints[int(joint) - 1]
        own = links[k].joint
        links[k] = replace(links[k], joint=replace(own, **{word: getattr(own, word) + added}))
    payload = arm.payload
    if mass is not None:
        carried = payload or Payload(mass=0.0)
        payload = replace(carried, mass=carried.mass + mass)
    return replace(arm, links=tuple(links), payload=payload)


def _scaled(link: Link, stiffness: float, damping: float, friction: float) -> Link:
    """The link with factors; damping coefficients do not follow the stiffness."""
    joint = replace(
        link.joint,
        viscous=friction * link.joint.viscous,
        coulomb=friction * link.joint.coulomb,
        spring_damping=damping * link.joint.spring_damping,
        stiffness=link.joint.stiffness and stiffness * link.joint.stiffness,
    )
    names = STIFFNESS.values()
    sections = tuple(replace(x, **_times(x, names, stiffness)) for x in link.sections)
    whole = {} if sections else _times(link, names, stiffness)
    own = link.damping_beta_torsion
    return replace(
        link,
        joint=joint,
        sections=sections,
        damping_ratio=link.damping_ratio * damping / stiffness**0.5,
        damping_beta=link.damping_beta * damping / stiffness,
        damping_beta_torsion=own and own * damping / stiffness,
        **whole,
    )


def _times(part: Link | Section, names: Iterable[str], factor: float) -> dict[str, Any]:
    """Fields of a link or a section times a factor; None stays None."""
    fields = {name: getattr(part, name) for name in names}
    return {
        name: tuple(factor * x for x in value) if isinstance(value, tuple) else factor * value
        for name, value in fields.items()
        if value is not None
    }
