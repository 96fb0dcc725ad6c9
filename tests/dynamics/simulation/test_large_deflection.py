"""Foreshortening and segments against geometrically nonlinear beams.

Sources: the rotating cantilever's frequencies (hub radius 0) and the cantilever under a dead tip
load are classical; the numbers here are from a converged shooting solution of the exact beam.
"""

from typing import Any

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import fsolve

from dynamics import Model, compile_arm, load_arm

# eta = Omega sqrt(rho_A L^4 / EI): first flap and lag frequency times the same root
ROTATING = {
    0.0: (3.516015, 3.516015),
    1.0: (3.681647, 3.543236),
    2.0: (4.137320, 3.621797),
    3.0: (4.797279, 3.743512),
    4.0: (5.585001, 3.897723),
}
# alpha = P L^2 / EI: drop / L and x / L of the tip
DEAD_LOAD = {
    0.5: (0.16214358, 0.98408104),
    1.0: (0.30172077, 0.94356676),
    2.0: (0.49345748, 0.83935828),
}


def a_beam(
    modes: int, directions: str = "y", kind: str = "clamped-free", **changes: Any
) -> dict[str, Any]:
    """A cantilever of unit length, mass per length and stiffness, as an arm file."""
    foreshortening = changes.pop("foreshortening", True)
    gravity = changes.pop("gravity", [0.0, 0.0, 0.0])
    link = {
        "length": 1.0, "rho_A": 1.0, "EIz": 1.0, "EIy": 1.0, "joint": {"rotor_inertia": 1.0},
        "modes": [
            {"kind": kind, "index": k + 1, "direction": d}
            for d in directions
            for k in range(modes)
        ],
    }  # fmt: skip
    return {"gravity": gravity, "foreshortening": foreshortening, "links": [link | changes]}


def spinning_frequencies(model: Model, omega: float) -> np.ndarray:
    """Modal frequencies at a steady joint rate, from the derivative of the bias at delta = 0."""
    n, step = model.n, 1e-6
    v = np.zeros(n)
    v[0] = omega

    def force(delta: np.ndarray) -> np.ndarray:
        return model.bias(np.concatenate([[0.0], delta]), v)[1:]

    K = np.column_stack([
        (force(step * e) - force(-step * e)) / (2.0 * step) for e in np.eye(n - 1)
    ])  # fmt: skip
    M = model.mass_matrix(np.zeros(n))[1:, 1:]
    return np.sqrt(scipy.linalg.eigvalsh(0.5 * (K + K.T), M))


@pytest.mark.parametrize("eta", ROTATING)
def test_a_foreshortened_beam_stiffens_as_it_spins(eta: float) -> None:
    flap, lag = ROTATING[eta]
    vertical = spinning_frequencies(compile_arm(a_beam(3, "z")), eta)
    horizontal = spinning_frequencies(compile_arm(a_beam(3, "y")), eta)
    assert vertical[0] == pytest.approx(flap, rel=2e-3)
    assert horizontal[0] == pytest.approx(lag, rel=2e-3)


def test_the_linear_beam_loses_its_stiffness_at_its_own_frequency() -> None:
    """lag^2 = omega_1^2 - Omega^2, unlike the exact beam: the reason for foreshortening."""
    model = compile_arm(a_beam(1, foreshortening=False))
    assert spinning_frequencies(model, 3.0)[0] == pytest.approx(np.sqrt(3.5160152685**2 - 9.0))
    v = np.array([3.6, 0.0])
    assert model.bias(np.array([0.0, 0.1]), v)[1] < 0.0  # pushes outward


@pytest.mark.parametrize("alpha", DEAD_LOAD)
def test_segments_deflect_like_the_exact_beam(alpha: float) -> None:
    """Four segments of two polynomial modes, foreshortened: within 0.5 % of the elastica."""
    light = {"rho_A": 1e-9, "tip_mass": alpha, "segments": 4}
    model = compile_arm(a_beam(2, kind="poly", gravity=[0.0, -1.0, 0.0], **light))

    def force(delta: np.ndarray) -> np.ndarray:
        return model.bias(np.concatenate([[0.0], delta]), np.zeros(model.n))[1:]

    delta, _, solved, message = fsolve(force, np.zeros(model.n - 1), full_output=True, xtol=1e-12)
    assert solved == 1, message
    tip = model.tip(np.concatenate([[0.0], delta]))
    drop, along = DEAD_LOAD[alpha]
    assert -tip[1] == pytest.approx(drop, rel=5e-3)
    assert tip[0] == pytest.approx(along, rel=5e-3)


def test_segments_of_a_rigid_link_change_nothing() -> None:
    whole = compile_arm(a_beam(0))
    parts = compile_arm(a_beam(0, segments=3))
    assert parts.n == whole.n == 1
    np.testing.assert_allclose(parts.mass_matrix([0.3]), whole.mass_matrix([0.3]), rtol=1e-14)
    np.testing.assert_allclose(parts.tip([0.3]), whole.tip([0.3]), rtol=1e-14)


def test_segments_name_their_coordinates_from_the_root() -> None:
    arm = load_arm(a_beam(2, segments=2))
    assert arm.names == ("q1", "d1_1", "d1_2", "d1_3", "d1_4")
    assert load_arm(arm.to_dict()) == arm
