"""`python -m dynamics evaluate` against an independent method, case by case."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics.__main__ import main
from tests.paths import REFERENCE

CASES = sorted(
    path.stem
    for path in REFERENCE.glob("*.json")
    if "states" in json.loads(path.read_text()).get("expected", {})
)
ENERGY = 1e-7  # of the largest energy; of the order of a tip error of 1e-6 m


@pytest.fixture(params=CASES, scope="module")
def evaluated(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Result of the command line for a case, and the expected result."""
    case, out = REFERENCE / f"{request.param}.json", tmp_path_factory.mktemp("case") / "out.json"
    assert main(["evaluate", str(case), "--out", str(out)]) == 0
    return json.loads(out.read_text()), json.loads(case.read_text())["expected"]


def test_states_agree_to_1e_9(evaluated: tuple[dict[str, Any], dict[str, Any]]) -> None:
    result, expected = evaluated
    assert result["names"] == expected["names"]
    for got, want in zip(result["states"], expected["states"], strict=True):
        assert set(got) == {"M", "h", "acc"}
        for key in got:
            size = float(np.abs(want[key]).max())
            assert_allclose(got[key], want[key], rtol=0.0, atol=1e-9 * size, err_msg=key)


def test_frequencies_agree_to_1e_8(evaluated: tuple[dict[str, Any], dict[str, Any]]) -> None:
    result, expected = evaluated
    assert set(result["frequencies_rad_s"]) == {"joints_locked", "joints_free"}
    for key, got in result["frequencies_rad_s"].items():
        if "frequencies_rad_s" in expected:
            assert_allclose(got, expected["frequencies_rad_s"][key], rtol=1e-8, err_msg=key)


def test_tip_motion_agrees_to_a_micrometre(
    evaluated: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    motion, expected = evaluated[0]["motion"], evaluated[1]["motion"]
    of_free_base = {"base_quaternion", "linear_momentum", "angular_momentum_about_origin"}
    further = of_free_base if "base_quaternion" in expected else set()
    assert set(motion) == {"t", "tip", "q", "qd", "T", "V"} | further
    assert_allclose(motion["t"], expected["t"], rtol=1e-12)
    assert_allclose(motion["tip"], expected["tip"], rtol=0.0, atol=1e-6)
    largest = float(max(np.abs(expected["T"]).max(), np.abs(expected["V"]).max()))
    for key in ("T", "V"):
        assert_allclose(motion[key], expected[key], atol=ENERGY * largest, err_msg=key)
    for key in sorted(further):
        assert_allclose(motion[key], expected[key], rtol=0.0, atol=1e-7, err_msg=key)
    assert_allclose(motion["q"], expected["q"], rtol=0.0, atol=1e-6)


def test_a_motion_that_diverges_ends_with_status_3_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = json.loads((REFERENCE / "S1_m2.json").read_text())
    case["torque"] = [{"type": "piecewise-constant", "t": [0.0], "v": [1e25]}]
    (tmp_path / "case.json").write_text(json.dumps(case))

    status = main(["evaluate", str(tmp_path / "case.json"), "--out", str(tmp_path / "out.json")])

    out, err = capsys.readouterr()
    assert (status, out) == (3, "")
    assert err.count("\n") == 1
    assert not (tmp_path / "out.json").exists()


@pytest.mark.parametrize("word", ["linear", "skew"])
def test_a_case_with_the_linear_rotation_follows_from_its_positions(
    word: str, tmp_path: Path
) -> None:
    """Without torques and damping the energy of the positions stays what it was."""
    case = json.loads((REFERENCE / "spatial_two_link_torsion.json").read_text())
    case |= {"rotation": word, "t_end": 0.1, "n_out": 101}
    for link in case["links"]:
        link["damping_ratio"] = link["joint"]["viscous"] = link["joint"]["coulomb"] = 0.0
    case["torque"] = [None] * len(case["links"])
    case["initial"] = {key: case["expected"]["states"][0][key] for key in ("q", "qd")}
    (tmp_path / "case.json").write_text(json.dumps(case))
    out = tmp_path / "out.json"
    assert main(["evaluate", str(tmp_path / "case.json"), "--out", str(out)]) == 0
    motion = json.loads(out.read_text())["motion"]
    energy = np.add(motion["T"], motion["V"])
    assert np.ptp(motion["T"]) > 0.1 * max(motion["T"])
    assert_allclose(energy, energy[0], rtol=ENERGY)
