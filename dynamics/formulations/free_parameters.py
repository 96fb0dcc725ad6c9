"""Arm parameters that can stay inputs of compiled code and so differ between environments."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from dynamics.formulations.link_constants import LinkConstants


def _payload_mass(links: list[LinkConstants], p: Any) -> list[LinkConstants]:
    return [*links[:-1], replace(links[-1], tip_mass=links[-1].tip_mass + p)]


def _stiffness(links: list[LinkConstants], p: Any) -> list[LinkConstants]:
    return [
        replace(link, K=_scaled(link.K, p), spring=p * link.spring if link.spring else 0.0)
        for link in links
    ]


def _damping(links: list[LinkConstants], p: Any) -> list[LinkConstants]:
    return [
        replace(
            link,
            damping=_scaled(link.damping, p),
            viscous=link.viscous if link.driven or not link.viscous else p * link.viscous,
        )
        for link in links
    ]


def _friction(links: list[LinkConstants], p: Any) -> list[LinkConstants]:
    return [
        replace(
            link,
            viscous=p * link.viscous if link.driven and link.viscous else link.viscous,
            coulomb=p * link.coulomb if link.coulomb else 0.0,
        )
        for link in links
    ]


def _scaled(rows: Any, p: Any) -> Any:
    return tuple(tuple(p * x if x else 0.0 for x in row) for row in rows)


@dataclass(frozen=True)
class FreeParameter:
    """Parameter p of a compiled arm: nominal value, and a function that applies p to the links."""

    nominal: float
    apply: Callable[[list[LinkConstants], Any], list[LinkConstants]]


FREE_PARAMETERS = {
    "payload_mass": FreeParameter(0.0, _payload_mass),  # [kg] added at the last tip
    "stiffness": FreeParameter(1.0, _stiffness),  # [-] scales every K and joint spring
    "damping": FreeParameter(1.0, _damping),  # [-] scales all damping of modes and joint springs
    "friction": FreeParameter(1.0, _friction),  # [-] scales viscous and Coulomb friction
}
