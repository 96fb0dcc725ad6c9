"""Arm parameters that can stay inputs of compiled code and so differ between environments."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from dynamics.formulations.algebra import add, madd, matmul, mscale, scale, skew, transpose
from dynamics.formulations.kinematics import Chain
from dynamics.formulations.link_constants import LinkConstants


def _payload_mass(chain: Chain, p: Any) -> Chain:
    last = chain.links[-1]
    arm = skew(last.carried_at)
    moment: Any = add(last.tip_moment, scale(p, last.carried_at))
    inertia: Any = madd(last.tip_inertia, mscale(p, matmul(transpose(arm), arm)))
    heavier = replace(last, tip_mass=last.tip_mass + p, tip_moment=moment, tip_inertia=inertia)
    return replace(chain, links=(*chain.links[:-1], heavier))


def _stiffness(chain: Chain, p: Any) -> Chain:
    def scaled(link: LinkConstants) -> LinkConstants:
        spring = p * link.spring if link.spring else 0.0
        K, K_pairs = _scaled(link.K, p), _scaled(link.K_pairs, p)
        return replace(link, K=K, K_pairs=K_pairs, spring=spring)

    return replace(chain, links=tuple(map(scaled, chain.links)))


def _damping(chain: Chain, p: Any) -> Chain:
    def scaled(link: LinkConstants) -> LinkConstants:
        viscous = link.viscous if link.driven or not link.viscous else p * link.viscous
        return replace(link, damping=_scaled(link.damping, p), viscous=viscous)

    dampers = tuple(replace(damper, rate=p * damper.rate) for damper in chain.dampers)
    return replace(chain, links=tuple(map(scaled, chain.links)), dampers=dampers)


def _friction(chain: Chain, p: Any) -> Chain:
    def scaled(link: LinkConstants) -> LinkConstants:
        viscous = p * link.viscous if link.driven and link.viscous else link.viscous
        return replace(link, viscous=viscous, coulomb=p * link.coulomb if link.coulomb else 0.0)

    return replace(chain, links=tuple(map(scaled, chain.links)))


def _joint_friction(name: str, joint: int) -> Callable[[Chain, Any], Chain]:
    """Function that adds p to a friction coefficient, by its name, of a joint, counted from 0."""

    def apply(chain: Chain, p: Any) -> Chain:
        driven = [k for k, link in enumerate(chain.links) if link.driven]
        driven = driven[chain.driven_base :]  # a driven base comes first and has no friction
        if joint >= len(driven):
            raise ValueError(
                f"{name}_{joint + 1} is of no joint: this arm has {len(driven)} joints, counted "
                "from 1."
            )
        links = list(chain.links)
        link = links[driven[joint]]
        links[driven[joint]] = replace(link, **{name: getattr(link, name) + p})
        return replace(chain, links=tuple(links))

    return apply


def _scaled(rows: Any, p: Any) -> Any:
    return tuple(tuple(p * x if x else 0.0 for x in row) for row in rows)


@dataclass(frozen=True)
class FreeParameter:
    """Parameter p of a compiled arm: nominal value, and a function that applies p to the chain."""

    nominal: float
    apply: Callable[[Chain, Any], Chain]


JOINTS = 9  # first joints whose friction can be free
FREE_PARAMETERS = {
    "payload_mass": FreeParameter(0.0, _payload_mass),  # [kg] added at the payload's centre of mass
    "stiffness": FreeParameter(1.0, _stiffness),  # [-] scales every K and joint spring
    "damping": FreeParameter(1.0, _damping),  # [-] scales all damping of modes and joint springs
    "friction": FreeParameter(1.0, _friction),  # [-] scales viscous and Coulomb friction
} | {
    # [N m s/rad] and [N m] added to the friction of one joint, counted from 1
    f"{name}_{joint + 1}": FreeParameter(0.0, _joint_friction(name, joint))
    for joint in range(JOINTS)
    for name in ("viscous", "coulomb")
}
