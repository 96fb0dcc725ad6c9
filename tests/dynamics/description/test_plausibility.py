"""Arms in wrong units are warned of, once, and real arms are not."""

import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamics import ARMS, Arm, ImplausibleArmWarning, Joint, Link, Mode, compile_arm, load_arm
from dynamics.description import plausibility
from dynamics.description.plausibility import clamped_frequency
from tests.paths import ROOT

REFERENCES = [
    path
    for path in sorted((ROOT / "tests" / "reference").glob("*.json"))
    if "links" in json.loads(path.read_text(encoding="utf-8"))
]
BENDING = {"kind": "clamped-free", "index": 1, "direction": "y"}
MILLIMETRES: dict[str, dict[str, Any]] = {  # an aluminium strip of 0.8 m, 40 mm by 3 mm
    "mm, N, g": {"length": 800.0, "rho_A": 0.324, "EIz": 6.3e6, "modes": [BENDING]},
    "mm, N, kg": {"length": 800.0, "rho_A": 3.24e-4, "EIz": 6.3e6, "modes": [BENDING]},
    "mm, else SI": {"length": 800.0, "rho_A": 0.324, "EIz": 6.3, "modes": [BENDING]},
    "a short one in mm, else SI": {
        "length": 50.0, "rho_A": 0.324, "EIz": 6.3, "modes": [BENDING],
    },
    "rigid, in mm": {"length": 800.0, "rho_A": 0.324},
    "with an offset in mm": {"length": 0.8, "rho_A": 0.324, "joint": {"offset": [0, 0, 400.0]}},
}  # fmt: skip
REAL: dict[str, dict[str, Any]] = {
    "a mast of 60 m": {"length": 60.0, "rho_A": 5.0, "EIz": 1.2e7, "modes": [BENDING]},
    "a boom of 40 m": {"length": 40.0, "rho_A": 0.1, "EIz": 1.0e4, "modes": [BENDING]},
    "a station's arm with 100 t": {
        "length": 7.1, "rho_A": 20.0, "EIz": 4.0e6, "tip_mass": 0.9e5, "modes": [BENDING],
    },
    "a strip of silicon": {"length": 2e-3, "rho_A": 2.3e-6, "EIz": 1.4e-9, "modes": [BENDING]},
    "a fishing rod": {
        "sections": [{"length": 2.0, "rho_A": 0.1, "EIz": EI} for EI in (40.0, [10.0, 1.0])],
        "modes": [BENDING],
    },
    "a pin": {"length": 1e-2, "rho_A": 6e-3, "EIz": 1e-2, "modes": [BENDING]},
}  # fmt: skip


@pytest.fixture(autouse=True)
def nothing_told(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Forget the arms of other tests."""
    monkeypatch.setattr(plausibility, "_told", set())
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        yield


def sentences(recorded: Any) -> list[str]:
    return [str(w.message) for w in recorded if w.category is ImplausibleArmWarning]


@pytest.mark.parametrize("source", [*ARMS, *REFERENCES], ids=str)
def test_presets_and_reference_cases_are_plausible(source: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", ImplausibleArmWarning)
        arm = load_arm(source)
        load_arm(replace(arm, name="again"))


@pytest.mark.parametrize("link", REAL.values(), ids=REAL)
def test_the_largest_and_smallest_real_arms_are_plausible(link: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", ImplausibleArmWarning)
        load_arm({"links": [link]})


@pytest.mark.parametrize("link", MILLIMETRES.values(), ids=MILLIMETRES)
def test_an_arm_in_millimetres_is_warned_of(link: dict[str, Any], tmp_path: Path) -> None:
    """From a dict and from a file, at the line that loads it."""
    with pytest.warns(ImplausibleArmWarning, match="may not be in SI units: link 1") as recorded:
        load_arm({"name": "mine", "links": [link]})
    (warning,) = [w for w in recorded if w.category is ImplausibleArmWarning]
    assert warning.filename == __file__
    path = tmp_path / "arm.json"
    path.write_text(json.dumps({"links": [{**link, "length": 1.01 * link["length"]}]}))
    with pytest.warns(ImplausibleArmWarning) as recorded:
        load_arm(path)
    assert recorded[0].filename == __file__


def test_the_warning_names_the_quantity_its_value_and_the_other_links() -> None:
    arm = {"name": "mine", "links": [MILLIMETRES["mm, N, g"]] * 3}
    with pytest.warns(ImplausibleArmWarning) as recorded:
        load_arm(arm)
    assert sentences(recorded) == [
        "The arm 'mine' may not be in SI units: link 1 has a length of 800 m, and 3 links are "
        "implausible. Give lengths in m, masses in kg, mass per length in kg/m, EI in N "
        "m^2 and gravity in m/s^2; if they are, ignore this warning."
    ]
    for link, words in (
        ({"length": 2e-4, "rho_A": 1.0}, r"a length of 0\.0002 m"),
        ({"length": 3.0, "rho_A": 4e4}, "a mass of 120000 kg"),
        ({"length": 1.1, "rho_A": 1.0, "tip_mass": 2e5}, "a mass of 200001 kg"),
        ({"length": 1.2, "rho_A": 1.0, "EIy": 1e-5, "modes": [{**BENDING, "direction": "z"}]},
         r"a first bending frequency of 0\.0012\d Hz along z"),
        ({"length": 0.01, "rho_A": 1e-3, "EIz": 1e5, "modes": [BENDING]},
         r"a first bending frequency of 5\.68e\+07 Hz along y"),
        ({"sections": [{"length": 400.0, "rho_A": 0.324, "EIz": EI} for EI in (6.3, [3.0, 1.0])],
          "modes": [BENDING]}, "a length of 800 m"),
        ({"sections": [{"length": 0.45, "rho_A": 0.324, "EIz": EI} for EI in (6e-6, 3e-6)],
          "modes": [BENDING]}, r"a first bending frequency of 0\.00284 Hz along y"),
    ):  # fmt: skip
        with pytest.warns(ImplausibleArmWarning, match=rf"^The arm .* link 1 has {words}\. Give"):
            load_arm({"links": [link]})


def test_gravity_in_millimetres_is_warned_of_beside_links_that_are_real() -> None:
    link = {"length": 0.5, "rho_A": 1.0}
    with pytest.warns(ImplausibleArmWarning, match=r"units: gravity is 9810 m/s\^2\. Give"):
        load_arm({"gravity": [0.0, -9810.0, 0.0], "links": [link]})
    with pytest.warns(ImplausibleArmWarning, match=r"is 9810 m/s\^2, and 2 links are implaus"):
        load_arm({"gravity": [0.0, -9810.0, 0.0], "links": 2 * [{**link, "length": 500.0}]})


ROD, TURNED = {"length": 0.5, "rho_A": 1.0}, Rotation.from_rotvec([0.4, -0.9, 0.3]).as_matrix()
POINTS = np.random.default_rng(0).normal(size=(4, 3))  # [m] of 1 kg each
BODIES = {
    "a point": np.zeros((3, 3)),
    "a thin rod at any angle": TURNED @ np.diag([0.0, 0.3, 0.3]) @ TURNED.T,
    "a thin plate at any angle": TURNED @ np.diag([0.1, 0.3, 0.4]) @ TURNED.T,
    "a plate with rounded entries": np.diag([0.0083, 0.0208, 0.0292]),
    "points about a tip": np.sum([p @ p * np.eye(3) - np.outer(p, p) for p in POINTS], axis=0),
    "a moment in the plane alone": np.diag([0.0, 0.0, 0.1]),
}
NO_BODIES = {
    "one too large": np.diag([0.1, 0.1, 5.0]),
    "an axis without a moment": np.diag([0.0, 0.2, 0.3]),
    "at any angle": TURNED @ np.diag([0.1, 0.2, 0.4]) @ TURNED.T,
}


def with_inertia(where: str, inertia: Any) -> dict[str, Any]:
    moments = np.asarray(inertia).tolist()
    link = {**ROD, "tip_inertia": moments} if where == "Link.tip_inertia of link 1" else ROD
    body = {"mass": 1.0, "inertia": moments}
    if where == "Payload.inertia":
        return {"links": [link], "payload": body}
    return {"links": [{**link, "body": body}] if where == "Body.inertia of link 1" else [link]}


WHERE = ("Link.tip_inertia of link 1", "Body.inertia of link 1", "Payload.inertia")


@pytest.mark.parametrize("where", WHERE)
def test_an_inertia_of_no_body_is_warned_of_by_its_field_and_moments(where: str) -> None:
    for inertia in BODIES.values():
        with warnings.catch_warnings():
            warnings.simplefilter("error", ImplausibleArmWarning)
            load_arm(with_inertia(where, inertia))
    for inertia in NO_BODIES.values():
        least, middle, most = np.linalg.eigvalsh(inertia)
        words = rf"^{where} is .* moment {most:g} kg .* others, {least:g} and {middle:g}\. Check"
        with pytest.warns(ImplausibleArmWarning, match=words) as recorded:
            load_arm(with_inertia(where, inertia))
        assert recorded[0].filename == __file__
        plausibility._told.clear()


def test_an_arm_is_warned_of_once() -> None:
    """Its other models are not, wherever they go; an arm of other lengths is."""
    link = Link(length=800.0, rho_A=0.324, EIz=6.3e6, modes=(Mode(**BENDING),))
    arm = Arm(links=(link,))
    with pytest.warns(ImplausibleArmWarning):
        compile_arm(arm)
    stiffer = replace(link, EIz=7e6, modes=(), joint=Joint(rotor_inertia=1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error", ImplausibleArmWarning)
        for other in (arm, replace(arm, links=(stiffer,)), arm.to_dict()):
            load_arm(other)
    with pytest.warns(ImplausibleArmWarning):
        load_arm(replace(arm, links=(replace(link, length=801.0),)))


def test_the_frequency_is_that_of_the_clamped_beam() -> None:
    """3.516 for a bare one, to 2 %; sqrt(3) with a heavy tip."""
    bare = Link(length=2.0, rho_A=3.0, EIz=5.0, modes=(Mode(**BENDING),))
    exact = 3.516 / (2.0 * 3.14159265) * (5.0 / (3.0 * 2.0**4)) ** 0.5
    assert clamped_frequency(bare, 5.0) == pytest.approx(exact, rel=0.02)
    heavy = replace(bare, tip_mass=1e6)
    exact = (3.0 * 5.0 / (1e6 * 2.0**3)) ** 0.5 / (2.0 * 3.14159265)
    assert clamped_frequency(heavy, 5.0) == pytest.approx(exact, rel=1e-5)


def test_a_damping_ratio_in_percent_is_warned_of() -> None:
    with pytest.warns(ImplausibleArmWarning, match="a damping_ratio of 2, more than critical"):
        load_arm({"links": [{**REAL["a pin"], "damping_ratio": 2.0}]})
