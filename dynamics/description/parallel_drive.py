"""Parallel drives: a joint whose motor stands at the base of the joint before it.

A massless parallelogram along link i-1 carries the drive of joint i, as on RALF of Yuan, Book and
Huggins (1993): link 2's transform does not know link 1's rotation. Only the position of link i then
follows the tip of link i-1. Its angle q_i is that from what joint i-1 stands on, and there its
torque and every couple it passes on react. In the recursion link i-1 is `bypassed`: the next frame
stands on its joint's base (kinematics.outward), its own coordinates feel the next link's force but
no couple (gibbs_appell.felt, block_of), and its joint is no free axis for what lies beyond
(elimination._reduced).
"""

from collections.abc import Iterator

from dynamics.description.link import Link


def check(links: tuple[Link, ...]) -> None:
    """Refuse a parallel drive where a planar parallelogram along one link cannot be."""
    for i, link in enumerate(links, 1):
        if link.joint.parallel:
            for found, remedy in _faults(links[i - 2] if i > 1 else None, link):
                raise ValueError(
                    f"Joint.parallel of link {i} must be false, or {remedy}, got {found}."
                )


def _faults(before: Link | None, link: Link) -> Iterator[tuple[str, str]]:
    """What stands against it: what was found, and what to give instead."""
    if before is None:
        yield "the first joint", "the joint behind another"
        return
    for name, joint in (("this joint", link.joint), ("the joint before", before.joint)):
        if joint.type != "revolute":
            yield f"Joint.type {joint.type!r} of {name}", f'{name} "revolute"'
    if link.joint.rotation[2][2] != 1.0:
        yield f"Joint.rotation {link.joint.rotation!r}", "Joint.rotation a turn about z"
    if any(link.joint.offset):
        yield f"Joint.offset {link.joint.offset!r}", "Joint.offset zero"
    if before.joint.elastic:
        yield (
            f"Joint.stiffness {before.joint.stiffness!r} on the joint before",
            "no spring there",
        )
    if before.segments > 1:
        yield f"Link.segments {before.segments!r} of the link before", "that link in one piece"
    for direction in ("z", "x"):
        if before.in_direction(direction):
            yield (
                f'Link.modes of the link before along "{direction}"',
                'that link\'s modes along "y" or "axial"',
            )
