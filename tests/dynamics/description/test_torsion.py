"""Torsion modes that twist no inertia are refused; those that twist some are not."""

from typing import Any

import numpy as np
import pytest

from dynamics import Model, load_arm

BEND = {"kind": "clamped-tip-mass", "index": 1, "direction": "y"}
TWIST = {"kind": "torsion-fixed-free", "index": 1, "direction": "x"}
FIRST = {"length": 0.25, "rho_A": 1.2, "modes": [], "joint": {"rotor_inertia": 0.05}}
SECOND: dict[str, Any] = {
    "length": 0.6, "rho_A": 0.35, "EIz": 18.0, "EIy": 25.0, "GJ": 9.0, "modes": [BEND, TWIST],
    "joint": {"rotation": {"rpy": [np.pi / 2, 0.0, 0.0]}, "rotor_inertia": 0.03},
}  # fmt: skip
THIRD: dict[str, Any] = {
    "length": 0.5, "rho_A": 0.2, "EIz": 6.0, "EIy": 8.0, "tip_mass": 0.3, "modes": [BEND],
    "joint": {"rotor_inertia": 0.02},
}  # fmt: skip
ACROSS = {"rotation": {"axis": [0, 1, 0], "angle": 1.0}, "rotor_inertia": 0.02}


def described(second: dict[str, Any], third: dict[str, Any], **arm: Any) -> dict[str, Any]:
    return {"links": [FIRST, {**SECOND, **second}, {**THIRD, **third}], **arm}


def least(arm: dict[str, Any]) -> float:
    """Least eigenvalue of the straight arm's mass matrix."""
    model = Model(load_arm(arm))
    return float(np.linalg.eigvalsh(model.mass_matrix(np.zeros(model.n)))[0])


IN_LINE: list[tuple[dict[str, Any], dict[str, Any]]] = [
    ({}, {}),
    ({}, {"joint": {"offset": [0.1, 0.0, 0.0]}}),
    ({}, {"joint": {"type": "fixed", "rotation": {"rpy": [0.4, 0.0, 0.0]}}}),
    ({}, {"modes": [], "body": {"mass": 0.4, "com": [0.1, 0.0, 0.0]}}),
]


@pytest.mark.parametrize(("second", "third"), IN_LINE)
def test_a_twist_without_inertia_is_refused(second: dict[str, Any], third: dict[str, Any]) -> None:
    """With next to none the mass matrix of the straight arm is singular."""
    with pytest.raises(ValueError, match=r"Link 2 has a torsion mode but .* give rho_Ip \[kg m\]"):
        load_arm(described(second, third))
    assert least(described({**second, "rho_Ip": 1e-20}, third)) < 1e-15


@pytest.mark.parametrize(
    ("second", "third", "arm"),
    [
        ({"rho_Ip": 1e-4}, {}, {}),
        ({"tip_inertia": [[1e-4, 0, 0], [0, 0, 0], [0, 0, 0]]}, {}, {}),
        ({}, {"rho_Ip": 1e-4}, {}),
        ({}, {"joint": ACROSS}, {}),
        ({}, {"joint": {"offset": [0.0, 0.05, 0.0]}}, {}),
        ({}, {"joint": {"root": [0.0, 0.0, 0.05]}}, {}),
        ({}, {"modes": [], "body": {"mass": 0.4, "com": [0.0, 0.1, 0.0]}}, {}),
        ({}, {}, {"payload": {"mass": 0.1, "com": [0.0, 0.1, 0.0]}}),
    ],
)
def test_a_twist_that_moves_inertia_is_taken(
    second: dict[str, Any], third: dict[str, Any], arm: dict[str, Any]
) -> None:
    assert least(described(second, third, **arm)) > 1e-6


def test_modes_by_rule_leave_torsion_out_where_it_has_no_inertia() -> None:
    arm = load_arm(described({"modes": "auto"}, {"modes": "auto"}))
    assert not arm.links[1].in_direction("x")
