"""Changes of arms that several benchmarks make."""

from dataclasses import replace

from dynamics import Arm
from dynamics.types import Matrix3

# mounting of a joint whose axis is perpendicular to the one before: +90 degrees about x
ACROSS: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))


def undamped(arm: Arm) -> Arm:
    """The arm without damping of its links."""
    links = tuple(
        replace(link, damping_ratio=0.0, damping_beta=0.0, damping_beta_torsion=None)
        for link in arm.links
    )
    return replace(arm, links=links)
