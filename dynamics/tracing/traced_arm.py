"""An arm prepared for tracing: its chain of bodies, and the parameters that stay inputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.description.arm import Arm
from dynamics.formulations import free_base
from dynamics.formulations.damping import damped_chain
from dynamics.formulations.free_parameters import FREE_PARAMETERS
from dynamics.formulations.kinematics import Chain, Damper
from dynamics.formulations.link_constants import LinkConstants
from dynamics.formulations.table import Formulation, formulation_for


def slices(widths: Mapping[str, int]) -> dict[str, slice]:
    """Consecutive slices of the given widths, by name."""
    ends = pairwise(accumulate(widths.values(), initial=0))
    return {name: slice(*pair) for name, pair in zip(widths, ends, strict=True)}


@dataclass(frozen=True)
class TracedArm:
    """An arm, its formulation, and the names in FREE_PARAMETERS that stay inputs."""

    arm: Arm
    free_parameters: tuple[str, ...] = ()
    formulation: str = "gibbs_appell"

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.arm.n

    @property
    def n_joint(self) -> int:
        """Number of joints that move."""
        return self.arm.n_joint

    @property
    def n_torque(self) -> int:
        """Number of torques."""
        return self.arm.n_torque

    def along_chain(self, tau: Sequence[Any]) -> list[Any]:
        """(n_torque,) torques in the order of the chain: that of a driven base comes first."""
        return [*tau[self.n_joint :], *tau[: self.n_joint]]

    @cached_property
    def formed(self) -> Formulation:
        """The formulation; refuses an arm with features that it does not support."""
        return formulation_for(self.arm, self.formulation)

    @cached_property
    def _damped(self) -> tuple[list[tuple[LinkConstants, ...]], tuple[Damper, ...]]:
        return damped_chain(self.arm)

    @cached_property
    def chain(self) -> Chain:
        """All bodies from the base to the tip, with gravity."""
        base = free_base.bodies(self.arm.base)
        links, dampers = self._damped
        bodies = (*base, *(body for link in links for body in link))
        return Chain(
            bodies, self.arm.gravity, self.arm.rotation, self.arm.base.spatial, dampers,
            self.arm.base.driven,
        )  # fmt: skip

    @cached_property
    def bodies(self) -> tuple[slice, ...]:
        """Slice of each link's segments in `chain.links`; a link's rotor precedes its segments."""
        first = len(free_base.bodies(self.arm.base))
        ends = accumulate((len(link) for link in self._damped[0]), initial=first)
        segments = (link.segments for link in self.arm.links)
        return tuple(
            slice(stop - count, stop) for stop, count in zip(list(ends)[1:], segments, strict=True)
        )

    @property
    def n_gravity(self) -> int:
        """Number of gravity inputs: three with gravity on a free base, whose frame turns."""
        return 3 if self.arm.base.spatial and any(self.arm.gravity) else 0

    @cached_property
    def nominal_parameters(self) -> NDArray[np.float64]:
        """Values of the free parameters that reproduce the described arm."""
        return np.array([FREE_PARAMETERS[name].nominal for name in self.free_parameters])

    @cached_property
    def measurements(self) -> dict[str, slice]:
        """Columns of the measurements (`graphs.measure`), by name."""
        m = len(self.arm.links)
        return slices({
            "tip": 3, "tip_velocity": 3, "rigid_tip": 3, "deflection": m, "slope": m,
            "curvature": 2 * m,
        })  # fmt: skip

    @property
    def n_measure(self) -> int:
        """Number of measurement columns."""
        return self.measurements["curvature"].stop
