"""Formulations of the equations of motion, by name.

To add one, write a module with `mass_matrix(chain, q)` and `bias(chain, q, v)` over any scalar type
and enter it in FORMULATIONS. Without a solver of its own, its whole mass matrix is factored.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from dynamics.description import validate
from dynamics.description.arm import FOURTH_ORDER, Arm
from dynamics.formulations import (
    articulated_body,
    dense_solve,
    gibbs_appell,
    kinematics,
    lagrange_book,
    orthogonal_complement,
)
from dynamics.formulations.algebra import Scalar, Vector, dot, plus
from dynamics.formulations.articulated_body import Implicit
from dynamics.formulations.dense_solve import Equations
from dynamics.formulations.kinematics import Chain, outward, poses

State = Sequence[Scalar]  # (n,)


def _tip_velocity(chain: Chain, q: State, v: State) -> Vector:
    return poses(outward(chain, q, v))[-1].tip_velocity


class Recursion(Protocol):
    """Functions of a module that solves the equations of motion link by link, in O(n)."""

    def accelerations(
        self, chain: Chain, q: State, v: State, tau: State, implicit: Implicit | None
    ) -> list[Scalar]:
        """(n,) accelerations under torques tau."""

    def response(
        self, chain: Chain, q: State, forces: State, implicit: Implicit | None
    ) -> list[Scalar]:
        """(n,) accelerations that forces on the coordinates cause alone."""

    def imbalance(
        self, chain: Chain, q: State, v: State, tau: State, a: State, implicit: Implicit | None
    ) -> list[Scalar]:
        """(n,) forces that lack accelerations; zero of a that solves the equations of motion."""


@dataclass(frozen=True, kw_only=True)
class Formulation:
    """Equations of motion, with the energies and tip velocity of the same convention."""

    equations: Equations
    recursion: Recursion | None = None  # None: factor the whole mass matrix
    inverse: Callable[[Chain, State, State, State], list[Scalar]] | None = None  # None: of M and h
    energies: Callable[[Chain, State, State], tuple[Scalar, Scalar, Scalar]] = kinematics.energies
    tip_velocity: Callable[[Chain, State, State], Vector] = _tip_velocity  # [m/s]
    supported: Mapping[str, frozenset[str]] | None = None  # class -> fields; None: all

    def accelerations(
        self, chain: Chain, q: State, v: State, tau: State, implicit: Implicit | None = None
    ) -> list[Scalar]:
        """(n,) accelerations under joint torques tau."""
        if self.recursion:
            return self.recursion.accelerations(chain, q, v, tau, implicit)
        return dense_solve.accelerations(self.equations, chain, q, v, tau, implicit)

    def inverse_dynamics(self, chain: Chain, q: State, v: State, v_dot: State) -> list[Scalar]:
        """(n,) generalized forces M v_dot + h."""
        if self.inverse:
            return self.inverse(chain, q, v, v_dot)
        M, h = self.equations.mass_matrix(chain, q), self.equations.bias(chain, q, v)
        return [plus(dot(row, v_dot), force) for row, force in zip(M, h, strict=True)]


# Fields that "book" and "complement" support; all others must keep their defaults.
FIXED_BASE_AND_REVOLUTE = {
    "Arm": frozenset({
        "links", "name", "description", "gravity", "rotation", "foreshortening", "payload",
    }),
    "Base": frozenset(),
    "Joint": frozenset({
        "rotation", "offset", "rotor_inertia", "hub_inertia", "viscous", "coulomb",
        "coulomb_speed",
    }),
    "Link": frozenset({
        "length", "rho_A", "EIz", "EIy", "GJ", "EA", "rho_Ip", "tip_mass", "tip_inertia", "modes",
        "damping_ratio", "damping_beta", "damping_beta_torsion", "segments", "lumped",
        "joint", "body", "sections",
    }),
}  # fmt: skip

FORMULATIONS = {
    "gibbs_appell": Formulation(
        equations=gibbs_appell, recursion=articulated_body, inverse=gibbs_appell.inverse_dynamics
    ),
    "book": Formulation(
        equations=lagrange_book, energies=lagrange_book.energies,
        tip_velocity=lagrange_book.tip_velocity,
        supported=FIXED_BASE_AND_REVOLUTE,
    ),
    "complement": Formulation(equations=orthogonal_complement, supported=FIXED_BASE_AND_REVOLUTE),
}  # fmt: skip


def formulation_for(arm: Arm, name: str) -> Formulation:
    """Return a formulation by name; raise ValueError if it is unknown or unsuitable for the arm."""
    validate.known(name, "formulation", FORMULATIONS)
    refusal = why_not(arm, name)
    if refusal:
        raise ValueError(refusal)
    return FORMULATIONS[name]


def why_not(arm: Arm, name: str) -> str | None:
    """Sentence that names an unsupported field of an arm; None if all are supported."""
    supported = FORMULATIONS[name].supported
    if supported is not None and arm.foreshortening == FOURTH_ORDER:
        return (
            f"Formulation {name!r} does not support Arm.foreshortening, got {FOURTH_ORDER!r}; take "
            'true, false or "gibbs_appell".'
        )
    for owner, field, value in _described(arm):
        if supported is not None and field not in supported[owner]:
            return (
                f"Formulation {name!r} does not support {owner}.{field}, got {value!r}; "
                'leave it at its default or use "gibbs_appell".'
            )
    return None


def _described(arm: Arm) -> Iterator[tuple[str, str, object]]:
    """(class, field, value) of every field of an arm that differs from its default."""
    whole = arm.to_dict()
    base, links = whole.pop("base", {}), whole["links"]
    joints = [link.get("joint", {}) for link in links]
    for owner, parts in (("Arm", [whole]), ("Base", [base]), ("Link", links), ("Joint", joints)):
        for part in parts:
            for field, value in part.items():
                yield owner, field, value
