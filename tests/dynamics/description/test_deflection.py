"""Bent links: they keep their length, and one link's shapes are not another's."""

import numpy as np

from dynamics.description.deflection import deflection, shortening
from dynamics.description.link import Link
from dynamics.description.mode_shapes import Mode
from dynamics.types import Array

DELTA = np.array([0.023, -0.011, 0.017])
X = np.linspace(0.0, 0.8, 2001)


def bending_link(tip_mass: float = 0.0) -> Link:
    """A link of three modes that bends both ways; the tip mass changes their shapes."""
    modes = [("y", 1), ("z", 1), ("y", 2)]
    return Link(
        length=0.8, rho_A=0.3, EIz=2.0, EIy=3.0, tip_mass=tip_mass,
        modes=tuple(
            Mode(kind="clamped-tip-mass", index=index, direction=direction)
            for direction, index in modes
        ),
    )  # fmt: skip


def line(link: Link, delta: Array) -> Array:
    """Centre line of a bent link."""
    points = deflection(link, delta, X)
    points[:, 0] += X + shortening(link, delta, X)
    return points


def test_a_shortened_link_keeps_its_length_to_fourth_order() -> None:
    errors = []
    for factor in (1.0, 0.5):
        parts = np.diff(line(bending_link(), factor * DELTA), axis=0)
        errors.append(float(np.linalg.norm(parts, axis=1).sum()) - 0.8)
    shorter = -float(shortening(bending_link(), DELTA, X)[-1])
    assert 0.0 < abs(errors[0]) < 0.02 * shorter
    np.testing.assert_allclose(errors[0] / errors[1], 16.0, rtol=0.02)


def test_links_are_drawn_by_their_own_shapes() -> None:
    """In any order, at any points, and no picture changes what the next one is drawn from."""
    heavy, light = bending_link(5.0), bending_link()
    first = line(light, DELTA)
    assert np.abs(line(heavy, DELTA) - first).max() > 1e-3
    np.testing.assert_array_equal(line(light, DELTA), first)
    np.testing.assert_allclose(deflection(light, DELTA, X[::10])[:, 1:], first[::10, 1:])
