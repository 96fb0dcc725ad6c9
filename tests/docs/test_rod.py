"""The fishing rod of docs/own_arm.md: its printed numbers against its exact beam."""

import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from dynamics import Arm, Link, Mode, Section, load_arm
from dynamics.model import Model
from tests.docs.test_pages import DOCS, blocks

TEXT = (DOCS / "own_arm.md").read_text(encoding="utf-8")
FILE = next(text for language, text in blocks("own_arm") if text.startswith("# rod.yaml"))
LINK: dict[str, Any] = yaml.safe_load(FILE)["links"][0]
PARTS: list[dict[str, Any]] = LINK["sections"]
LENGTH = sum(part["length"] for part in PARTS)


def printed(start: str) -> list[float]:
    """Numbers in the comment of the line of Python that starts so."""
    (line,) = (line for line in TEXT.splitlines() if line.startswith(start))
    return [float(x) for x in re.findall(r"(?<!\w)\d+\.\d+", line.partition("#")[2])]


def along(part: dict[str, Any], name: str, share: float) -> float:
    inner, outer = part[name] if isinstance(part[name], list) else (part[name], part[name])
    return float(inner + share * (outer - inner))


def exact_hertz(low: float, high: float, hub: float | None = None) -> float:
    """[Hz] of the exact beam, from its differential equation for (w, w', M, V)."""

    def determinant(hertz: float) -> float:
        squared = (2.0 * np.pi * hertz) ** 2
        bent = [0.0, 0.0, 1.0, 0.0] if hub is None else [0.0, 1.0, -squared * hub, 0.0]
        ends = []
        for state in (bent, [0.0, 0.0, 0.0, 1.0]):
            y = np.array(state)
            for part in PARTS:

                def rate(x: float, y: np.ndarray, part: dict[str, Any] = part) -> list[float]:
                    share = x / part["length"]
                    EI, rho_A = along(part, "EIz", share), along(part, "rho_A", share)
                    return [y[1], y[2] / EI, y[3], squared * rho_A * y[0]]

                y = solve_ivp(rate, (0.0, part["length"]), y, rtol=1e-9, atol=1e-12).y[:, -1]
            ends.append([y[2], y[3] + squared * LINK["tip_mass"] * y[0]])
        return float(np.linalg.det(ends))

    return float(brentq(determinant, low, high, xtol=1e-6))


@pytest.mark.parametrize("joints", ["locked", "free"])
def test_the_frequencies_of_the_rod_are_those_of_its_exact_beam(joints: str) -> None:
    numbers = printed(f'print(rod.frequencies(joints="{joints}")')
    hub = LINK["joint"]["rotor_inertia"] if joints == "free" else None
    exact = [exact_hertz(0.95 * f, 1.05 * f, hub) for f in numbers]
    assert_allclose(numbers, exact, rtol=2e-4)
    found = Model(load_arm(yaml.safe_load(FILE))).frequencies(joints=joints) / (2.0 * np.pi)
    assert_allclose(found, exact, rtol=1e-6 if joints == "locked" else 1e-3)
    assert_allclose(found, numbers, rtol=2e-4)


def test_the_stiffness_of_the_rod_is_the_integral_of_its_moment() -> None:
    compliance, begin = 0.0, 0.0
    for part in PARTS:

        def bent(x: float, part: dict[str, Any] = part, begin: float = begin) -> float:
            return float((LENGTH - begin - x) ** 2 / along(part, "EIz", x / part["length"]))

        compliance += quad(bent, 0.0, part["length"])[0]
        begin += part["length"]
    assert printed("print(3 * link.tip_rigidity") == pytest.approx([1.0 / compliance], rel=2e-4)


def test_a_uniform_link_of_its_mean_numbers_has_the_stated_frequencies() -> None:
    link = load_arm(yaml.safe_load(FILE)).links[0]
    mean = {name: link.mean(name) for name in ("rho_A", "EIz")}
    uniform = {**LINK, **mean, "length": link.length, "sections": []}
    found = Model(load_arm({"links": [uniform]})).frequencies() / (2.0 * np.pi)
    assert f"has {found[0]:.2f} and {found[1]:.1f} Hz" in TEXT


def test_ten_sections_of_a_cone_raise_its_first_frequency_as_stated() -> None:
    hertz = []
    for count in (10, 50):
        x = np.linspace(1.0, 0.5, count + 1).tolist()
        cone = tuple(
            Section(length=0.5 / count, rho_A=(a**2, b**2), EIz=(a**4, b**4))
            for a, b in pairwise(x)
        )
        link = Link(sections=cone, modes=(Mode(kind="clamped-free", index=1, direction="y"),))
        hertz.append(float(Model(Arm(links=(link,))).frequencies()[0]))
    excess = hertz[0] / hertz[1] - 1.0
    assert f"by {100.0 * excess:.1f} %" in " ".join(TEXT.split())
