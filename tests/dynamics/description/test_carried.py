"""Masses beyond a tip, beside an arm on a free base by brute force."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamics import Arm, Base, Body, Joint, Link, Payload
from dynamics.description.carried import Carried, carried
from dynamics.types import Array
from tests.dynamics import brute_force

UNIT = np.eye(3).tolist()


def random_links(rng: np.random.Generator, types: list[str]) -> tuple[Link, ...]:
    """Rigid links with everything that has a mass, behind joints of these types at any angle."""
    return tuple(
        Link(
            length=rng.uniform(0.3, 1.0),
            rho_A=rng.uniform(0.5, 4.0),
            rho_Ip=rng.uniform(0.1, 0.4),
            tip_mass=rng.uniform(0.1, 1.0),
            tip_inertia=np.diag(rng.uniform(0.1, 0.15, 3)).tolist(),
            body=random_body(rng) if rng.random() < 0.7 else None,
            joint=Joint(
                type=kind,
                rotation=Rotation.random(random_state=rng).as_matrix().tolist(),
                offset=tuple(rng.normal(0.0, 0.2, 3)),
                root=tuple(rng.normal(0.0, 0.2, 3)),
            ),
        )
        for kind in types
    )


def random_body(rng: np.random.Generator) -> Body:
    inertia = np.diag(rng.uniform(0.1, 0.15, 3)).tolist()
    return Body(mass=rng.uniform(0.1, 1.0), com=tuple(rng.normal(0.0, 0.3, 3)), inertia=inertia)


def on_a_base(links: tuple[Link, ...], payload: Payload | None) -> Array:
    """(4, 4) int p p^T dm, p = (x, y, z, 1), about a base of 1 kg and 1 kg m^2 with the links."""
    if not links:
        return np.zeros((4, 4))
    arm = Arm(links=links, payload=payload, base=Base(type="free", mass=1.0, inertia=UNIT))
    M = brute_force.mass_matrix(arm, np.zeros(arm.n))[:6, :6]
    first = M[1, 5], M[2, 3], M[0, 4]
    inertia, result = M[3:, 3:] - np.eye(3), np.empty((4, 4))
    result[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    result[3] = result[:, 3] = *first, M[0, 0] - 1.0
    return result


@pytest.mark.parametrize(
    "types", [["fixed", "revolute", "fixed"], ["prismatic", "revolute"], ["fixed", "fixed"]]
)
def test_a_tip_carries_what_a_base_in_its_place_would_move(types: list[str]) -> None:
    rng = np.random.default_rng(len(types))
    links = random_links(rng, ["revolute", *types])
    payload = Payload(mass=0.3, com=(0.1, -0.2, 0.3), inertia=random_body(rng).inertia)
    for i, beyond in enumerate(carried(links, payload)[:-1], 1):
        moving = next((k for k, link in enumerate(links) if k >= i and link.joint.moves), None)
        held = links[i:] if moving is None else links[i:moving]
        welded = on_a_base(held, payload if moving is None else None)
        np.testing.assert_allclose(beyond.whole, on_a_base(links[i:], payload), rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(beyond.welded, welded, rtol=0.0, atol=1e-9)
        assert beyond.joint == (None if moving is None else links[moving].joint)
        if moving is not None:
            turns = [np.array(link.joint.rotation) for link in links[i : moving + 1]]
            axis = np.linalg.multi_dot([*turns, [0.0, 0.0, 1.0]])
            np.testing.assert_allclose(beyond.axis, axis, rtol=1e-12)


@pytest.mark.parametrize("hub", [0.0, 0.7])
@pytest.mark.parametrize("rotor", [0.0, 0.4])
@pytest.mark.parametrize("changes", [{}, {"type": "prismatic"}, {"parallel": True}])
def test_the_inertia_that_a_tip_turns_is_what_a_free_joint_leaves_of_it(
    changes: dict[str, object], rotor: float, hub: float
) -> None:
    """By elimination of the joint from the mass matrix of the tip's turn and the joint's."""
    joint = Joint(**changes, rotor_inertia=rotor, hub_inertia=hub)  # type: ignore[arg-type]
    axis = np.array([0.48, 0.64, 0.6])
    welded, whole = np.diag([0.15, 0.15, 0.15, 1.0]), np.diag([0.4, 0.4, 0.4, 2.0])
    beyond = Carried(whole, welded, joint, axis)
    for direction, along in {"y": axis[2], "z": axis[1]}.items():
        turn = 0.0 if joint.type == "prismatic" else along  # of the hub with the tip
        M = 0.5 * np.array([[1.0, turn], [turn, 1.0]]) + hub * np.outer([turn, 1.0], [turn, 1.0])
        left = M[0, 0] - M[0, 1] ** 2 / (M[1, 1] + rotor)
        expected = 0.3 if joint.parallel else 0.3 + left
        assert beyond.turned_inertia()[direction] == pytest.approx(expected, rel=1e-12)
