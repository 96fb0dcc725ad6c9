"""Arms whose mass matrix is singular at rest, by coordinates that move no mass."""

import re
from typing import Any

import numpy as np
import pytest

from dynamics import Model, load_arm
from dynamics.formulations.linearized import inertia
from dynamics.tracing import graphs

ROD: dict[str, Any] = {"length": 0.5, "rho_A": 1.0}
NONE: dict[str, Any] = {"length": 0.0, "body": {"mass": 0.0}}
ACROSS = {"rotation": {"rpy": [0.5 * np.pi, 0.0, 0.0]}}
SLIDES = {"type": "prismatic"}
SINGULAR = {  # links, and the coordinates that move no mass
    "one axis": ([ROD, NONE, ROD], ["q2", "q3"]),
    "one axis, a mass on it": ([ROD, {**NONE, "body": {"mass": 2.0}}, ROD], ["q2", "q3"]),
    "one axis at the base": ([NONE, ROD], ["q1", "q2"]),
    "slides along one line": (
        [ROD, {**NONE, "joint": SLIDES}, {**ROD, "joint": SLIDES}], ["q2", "q3"],
    ),
    "a wrist that is straight": (
        [ROD, NONE, {**NONE, "joint": ACROSS}, {**ROD, "joint": ACROSS}], ["q2", "q4"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SINGULAR)
def test_coordinates_that_move_no_mass_are_named_with_what_mends_them(case: str) -> None:
    links, idle = SINGULAR[case]
    traced = Model(load_arm({"links": links})).traced
    assert np.linalg.eigvalsh(inertia(traced.chain, np.zeros(traced.n)))[0] < 1e-15
    named = re.escape(str(idle))
    with pytest.raises(ValueError, match=rf"singular at rest: {named} can move .*rotor_inertia"):
        graphs.check_rest(traced)

    first = int(idle[0][1:]) - 1
    joint = {**links[first].get("joint", {}), "rotor_inertia": 1e-3}
    mended = [*links[:first], {**links[first], "joint": joint}, *links[first + 1 :]]
    graphs.check_rest(Model(load_arm({"links": mended})).traced)
