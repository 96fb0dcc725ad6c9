"""Parallel drive: joint i is driven through a massless parallelogram along link i-1.

The parallelogram grounds the drive on the base of joint i-1, as on RALF of Yuan, Book and Huggins
(1993), where link 2's transform does not depend on link 1's rotation. The tip of link i-1 carries
link i in position only. The angle q_i is measured from the base of joint i-1, where the torque and
every moment of link i react. In the recursion link i-1 is `bypassed`:

- the next joint's base keeps the orientation of joint i-1's base (kinematics.outward),
- the next link exerts a force but no moment on its coordinates (gibbs_appell.wrench_on_link,
  block_of),
- its joint is not a free axis for the links beyond (articulated_body._articulated_inertia).
"""

from collections.abc import Iterator

from dynamics.description.link import Link


def check(links: tuple[Link, ...]) -> None:
    """Raise ValueError if a parallel drive has no planar parallelogram along the link before."""
    for i, link in enumerate(links, 1):
        if link.joint.parallel:
            for found, remedy in _faults(links[i - 2] if i > 1 else None, link):
                raise ValueError(
                    f"Joint.parallel of link {i} must be false, or {remedy}, got {found}."
                )


def _faults(before: Link | None, link: Link) -> Iterator[tuple[str, str]]:
    """Yield (finding, remedy) for each reason why `link` cannot have a parallel drive."""
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
    if any(before.joint.root):
        yield f"Joint.root {before.joint.root!r} of the joint before", "Joint.root zero there"
    if before.segments > 1:
        yield f"Link.segments {before.segments!r} of the link before", "that link in one piece"
    for direction in ("z", "x"):
        if before.in_direction(direction):
            yield (
                f'Link.modes of the link before along "{direction}"',
                'that link\'s modes along "y" or "axial"',
            )
