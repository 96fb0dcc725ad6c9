"""Case files are read completely or refused with one sentence."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynamics.__main__ import check_target, listing, main, write
from dynamics.arms import ARMS
from dynamics.simulation.case_file import Torque, case_from_dict, load_case
from tests.paths import REFERENCE

NEGATIVE = json.loads((REFERENCE / "negative.json").read_text())["cases"]
FREE = {
    "type": "free", "mass": 2.0, "inertia": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "position": [1.0, 2.0, 3.0], "quaternion": [0.0, 1.0, 0.0, 0.0],
    "velocity": [0.1, 0.2, 0.3], "angular_velocity_body": [0.4, 0.5, 0.6],
}  # fmt: skip
STATE = {"q": [0.1, 0.01], "qd": [0.0, 0.0]}


def a_case(**changes: Any) -> dict[str, Any]:
    """A one-link case with a motion."""
    case = {
        "gravity": [0, -9.81, 0],
        "links": [
            {
                "length": 1.0,
                "rho_A": 1.0,
                "EIz": 10.0,
                "modes": [{"kind": "clamped-free", "index": 1, "direction": "y"}],
            }
        ],
        "initial": STATE,
        "t_end": 0.1,
    }
    merged = {**case, **changes}
    return {key: value for key, value in merged.items() if value != "absent"}


def as_numbers(value: Any) -> Any:
    """A copy with the strings NaN and Infinity as numbers."""
    if value in ("NaN", "Infinity"):
        return float(value)
    if isinstance(value, dict):
        return {key: as_numbers(entry) for key, entry in value.items()}
    return [as_numbers(entry) for entry in value] if isinstance(value, list) else value


@pytest.mark.parametrize("entry", NEGATIVE, ids=lambda entry: entry["why"])
@pytest.mark.parametrize("spelling", ["text", "numbers"])
def test_an_invalid_case_ends_the_command_with_status_2_and_one_sentence(
    entry: dict[str, Any], spelling: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = as_numbers(entry["case"]) if spelling == "numbers" else entry["case"]
    path = tmp_path / "case.json"
    path.write_text(json.dumps(case))  # NaN and Infinity as literals, which Python's reader accepts

    status = main(["evaluate", str(path)])

    out, err = capsys.readouterr()
    assert (status, out) == (2, "")
    assert err.startswith("case.json: ")
    assert err.count("\n") == 1
    assert len(err) < 300


STEP = {"type": "piecewise-constant", "t": [0.0, 0.5], "v": [1.0, 2.0]}
SINE = {"type": "sine", "amplitude": 2.0, "omega": 3.0, "phase": 0.5}
REFUSED = {
    "initial.q must have 2 numbers, got 3": {"initial": {"q": [0, 0, 0], "qd": [0, 0]}},
    "initial.qd is missing": {"initial": {"q": [0, 0]}},
    "'v' in initial; nearest known: 'q": {"initial": {**STATE, "v": [0, 0]}},
    r"initial.q\[1\] must be a finite number": {"initial": {**STATE, "q": [0, float("inf")]}},
    "t_end is missing": {"t_end": "absent"},
    "t_end needs an initial state": {"initial": "absent"},
    "torque needs an initial state": {"initial": "absent", "t_end": "absent", "torque": [None]},
    "t_end must be positive, got -1.0": {"t_end": -1.0},
    "t_end .* got the text '1'": {"t_end": "1"},
    "n_out must be between 2": {"n_out": 1},
    "n_out must be an int, got 11.0": {"n_out": 11.0},
    "n_out must be an int, got True": {"n_out": True},
    "n_out must be between .*got 1000000000000": {"n_out": 10**12},
    "torque must have one entry per joint, and one of a driven base .1, null for none., got 2": {
        "torque": [None, None]
    },
    "torque must be a list": {"torque": STEP},
    r"torque\[0\] must be a mapping": {"torque": [1.0]},
    r"torque\[0\].type must be one of .*got 'ramp'": {"torque": [{**STEP, "type": "ramp"}]},
    r"torque\[0\].type must be one of .*got None": {"torque": [{**STEP, "type": None}]},
    r"torque\[0\].type is missing": {"torque": [{"t": [0.0], "v": [1.0]}]},
    r"torque\[0\].t must increase, got t\[1\] = 0.5": {"torque": [{**STEP, "t": [0.5, 0.5]}]},
    r"torque\[0\].t must not be negative, got -1.0": {"torque": [{**STEP, "t": [-1.0, 0.5]}]},
    r"torque\[0\].v must have 2 numbers, got 1": {"torque": [{**STEP, "v": [1.0]}]},
    r"torque\[0\].t must hold at least one": {"torque": [{**STEP, "t": [], "v": []}]},
    r"torque\[0\].v\[1\] .*finite": {"torque": [{**STEP, "v": [1.0, float("nan")]}]},
    r"torque\[0\].omega is missing": {"torque": [{"type": "sine", "amplitude": 1.0}]},
    r"torque\[0\].amplitude .*finite": {"torque": [{**SINE, "amplitude": float("inf")}]},
    r"'offset' in torque\[0\]": {"torque": [{**SINE, "offset": 1.0}]},
    r"states\[0\].q must have 2 numbers": {"states": [{**STATE, "q": [0.0]}]},
    r"states\[0\].tau must have 1 numbers, got 2": {"states": [{**STATE, "tau": [1.0, 2.0]}]},
    r"'M' in states\[0\]": {"states": [{**STATE, "M": []}]},
    "states must be a list": {"states": {}},
    "expected must be a mapping": {"expected": []},
    r"expected.states\[0\].q must have 2": {"expected": {"states": [{"q": [], "qd": []}]}},
    "'tend' in the case; nearest known: 't_end'": {"tend": 1.0},
    "Base.mass must be positive, got 0.0": {"base": {"type": "free"}},
    "'base_quaternion' in initial": {"initial": {**STATE, "base_quaternion": [1, 0, 0, 0]}},
    "initial.q must have 8 numbers, got 3": {"base": FREE, "initial": {"q": [0] * 3, "qd": [0]}},
    "initial.base_quaternion must have length 1": {
        "base": FREE,
        "initial": {**STATE, "base_quaternion": [1, 1, 0, 0]},
    },
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_a_bad_case_is_refused_with_a_sentence(sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        case_from_dict(a_case(**REFUSED[sentence]))


def test_states_come_from_the_case_or_else_from_its_expected_states() -> None:
    expected = {"states": [{**STATE, "tau": [3.0], "M": [[1.0]], "note": "ignored"}]}
    own = case_from_dict(a_case(states=[STATE, STATE], expected=expected))
    assert [state.tau for state in own.states] == [(0.0,), (0.0,)]
    other = case_from_dict(a_case(expected=expected))
    assert [state.tau for state in other.states] == [(3.0,)]


def test_a_free_base_starts_in_the_given_state_or_else_in_the_described_one() -> None:
    described = case_from_dict(a_case(base=FREE)).motion
    turn = 0.5 * np.pi
    given = {
        "q": [4.0, 5.0, 6.0, 0.0, 0.0, turn, *STATE["q"]], "qd": [0.0] * 8,
        "base_quaternion": [np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)],
    }  # fmt: skip
    own = case_from_dict(a_case(base=FREE, initial=given)).motion

    assert described is not None
    assert own is not None
    assert described.q == pytest.approx((1.0, 2.0, 3.0, np.pi, 0.0, 0.0, *STATE["q"]))
    assert described.qd == (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.0, 0.0)
    assert np.abs(own.q) == pytest.approx((4.0, 5.0, 6.0, 0.0, 0.0, np.pi, *STATE["q"]))
    assert own.qd == (0.0,) * 8


def test_frequencies_are_evaluated_at_the_start_of_the_motion() -> None:
    """Without a motion at the expected joint angles, else at zero."""
    assert case_from_dict(a_case()).joint_angles == (0.1,)
    still = {"initial": "absent", "t_end": "absent"}
    assert case_from_dict(a_case(**still)).joint_angles == (0.0,)
    expected = {"frequencies_rad_s": {"at_joint_angles": [0.7]}}
    assert case_from_dict(a_case(**still, expected=expected)).joint_angles == (0.7,)


@pytest.mark.parametrize("name", ["six_link_m2", "S1_m2", "two_link_friction_damping"])
def test_a_reference_case_evaluates_its_expected_times_states_and_angles(name: str) -> None:
    path = REFERENCE / f"{name}.json"
    data = json.loads(path.read_text())
    case = load_case(path)
    assert case.motion is not None
    np.testing.assert_allclose(case.motion.times, data["expected"]["motion"]["t"], rtol=1e-12)
    assert len(case.states) == len(data["expected"]["states"])
    assert list(case.joint_angles) == data["expected"]["frequencies_rad_s"]["at_joint_angles"]
    assert list(case.arm.names) == data["expected"]["names"]


def torque_of(*signals: Any) -> Torque:
    motion = case_from_dict({
        **a_case(torque=list(signals), initial={"q": [0] * 4, "qd": [0] * 4}),
        "links": a_case()["links"] * 2,
    }).motion  # fmt: skip
    assert motion is not None
    assert motion.torque is not None
    return motion.torque


def test_torque_jumps_at_its_breakpoints_and_is_constant_between() -> None:
    torque = torque_of({**STEP, "t": [0.25, 0.5]}, {**STEP, "t": [0.5, 0.75]})
    assert torque.breakpoints == (0.25, 0.5, 0.75)
    wanted = {0.0: (0, 0), 0.25: (1, 0), 0.4999: (1, 0), 0.5: (2, 1), 0.75: (2, 2), 9.0: (2, 2)}
    for t, values in wanted.items():
        assert tuple(torque(t)) == values


def test_a_sine_torque_has_no_breakpoints_and_a_null_torque_is_zero() -> None:
    torque = torque_of(SINE, None)
    assert torque.breakpoints == ()
    assert torque(0.4) == pytest.approx((2.0 * np.sin(3.0 * 0.4 + 0.5), 0.0))


def test_list_names_every_preset(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    assert capsys.readouterr().out == listing() + "\n"
    assert [line.split()[0] for line in listing().splitlines()] == list(ARMS)


def test_a_refusal_imports_neither_numba_nor_casadi(tmp_path: Path) -> None:
    code = (
        "import sys; from dynamics.__main__ import main; status = main(sys.argv[1:]); "
        "print(status, sorted({'casadi', 'numba'} & set(sys.modules)))"
    )
    command = [sys.executable, "-c", code, "evaluate", str(tmp_path / "gone.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "2 []"
    assert "no such file" in done.stderr


def test_an_output_path_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="existing folder"):
        check_target(tmp_path / "gone" / "out.json")
    with pytest.raises(ValueError, match="must be a file"):
        check_target(tmp_path)
    case = str(REFERENCE / "S1_m2.json")
    assert main(["evaluate", case, "--out", str(tmp_path / "gone" / "out.json")]) == 2


def test_a_result_replaces_an_old_file_and_leaves_no_other(tmp_path: Path) -> None:
    target = tmp_path / "out.json"
    target.write_text("old")
    write(target, "new")
    assert target.read_text() == "new\n"
    assert [path.name for path in tmp_path.iterdir()] == ["out.json"]
