"""Presets against published numbers, and flexible ones against finite elements."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.accuracy import tune_presets
from dynamics import ARMS, Arm
from dynamics.arms import CHECKS, presets
from dynamics.arms.checks import Check
from dynamics.arms.measures import alone, hertz
from tests.dynamics.beam_elements import beam_frequencies

ALL = [(name, check) for name in sorted(CHECKS) for check in CHECKS[name]]
FLEXIBLE = [  # every flexible link that bends along y
    (name, k)
    for name in sorted(ARMS)
    for k, link in enumerate(ARMS[name].links)
    if link.in_direction("y")
]


def test_a_file_beside_the_presets_is_a_preset() -> None:
    """Presets are found by file name, which is the arm's name."""
    files = {path.stem for path in Path(presets.__file__).parent.glob("*.py")} - {"__init__"}
    assert {name.replace("-", "_") for name in ARMS} == files
    assert list(CHECKS) == list(ARMS) == [arm.name for arm in ARMS.values()]


@pytest.mark.parametrize(
    ("name", "check"), ALL, ids=[f"{name}: {check.quantity}" for name, check in ALL]
)
def test_a_preset_meets_its_published_number(name: str, check: Check) -> None:
    assert check.measure(ARMS[name]) == pytest.approx(check.expected, rel=check.tolerance)


@pytest.mark.parametrize("name", sorted(ARMS))
def test_every_preset_has_a_check_that_a_wrong_arm_fails(name: str) -> None:
    """10 % more stiffness and 3 % more mass change a checked quantity."""

    def wrong(arm: Arm) -> Arm:
        links = tuple(
            replace(
                link,
                EIz=None if link.EIz is None else 1.1 * link.EIz,
                rho_A=1.03 * link.rho_A,
                body=link.body and replace(link.body, mass=1.03 * link.body.mass),
                joint=replace(link.joint, hub_inertia=1.1 * link.joint.hub_inertia),
            )
            for link in arm.links
        )
        return replace(arm, links=links)

    assert CHECKS[name]
    assert all(check.source for check in CHECKS[name])
    assert not all(check.passes(wrong(ARMS[name])) for check in CHECKS[name])


@pytest.mark.parametrize(("name", "link"), FLEXIBLE, ids=str)
def test_its_links_vibrate_as_finite_elements_do(name: str, link: int) -> None:
    """Each link alone, clamped, with its own tip body; four modes from eight shapes."""
    described = ARMS[name].links[link]
    expected = beam_frequencies(
        described.length, described.rho_A, described.EIz or 0.0,
        tip_mass=described.tip_mass, tip_inertia=described.tip_inertia[2][2],
    )  # fmt: skip
    clamped = replace(described.joint, stiffness=None, spring_damping=0.0)
    found = 2.0 * np.pi * np.array(hertz(alone(ARMS[name], link, 8, joint=clamped)))
    assert_allclose(found[:4], expected[:4], rtol=1e-5)


def test_the_hinged_forearm_vibrates_as_finite_elements_do() -> None:
    """The light hub on a free joint is close to the pinned boundary condition."""
    link = ARMS["sapienza-forearm"].links[1]
    expected = beam_frequencies(
        link.length, link.rho_A, link.EIz or 0.0, hinged=True, hub=link.joint.hub_inertia
    )
    found = 2.0 * np.pi * np.array(hertz(ARMS["sapienza-forearm"], "free"))
    alone_free = hertz(alone(ARMS["sapienza-forearm"], 1, 10, "pinned-free"), "free")
    assert_allclose(2.0 * np.pi * np.array(alone_free[:2]), expected[:2], rtol=2e-3)
    assert found[0] > expected[0]  # the upper arm is free too


@pytest.mark.parametrize(
    ("name", "link", "tuned"),
    [
        ("quanser-rotary-flexible-link", 0, tune_presets.tuned_ruler),
        ("sapienza-forearm", 1, tune_presets.tuned_forearm),
        ("ralf-like", 0, tune_presets.tuned_large_arm),
    ],
)
def test_a_tuned_rigidity_is_what_the_tuning_finds(name: str, link: int, tuned: object) -> None:
    assert callable(tuned)
    assert ARMS[name].links[link].EIz == pytest.approx(tuned(), rel=1e-4)


def test_density_and_tip_body_of_slim_are_what_its_printed_frequencies_imply() -> None:
    (link,) = ARMS["slim"].links
    own = (link.rho_A, link.tip_mass, link.tip_inertia[2][2])
    assert own == pytest.approx(tune_presets.tuned_slim(), rel=1e-3)


def test_the_booms_and_joints_of_the_shuttle_like_arm_are_tuned() -> None:
    shoulder, *booms = ARMS["srms-like"].links[:3]
    EI, *springs = tune_presets.tuned_shuttle()

    assert [rigidity for boom in booms for rigidity in (boom.EIz, boom.EIy)] == pytest.approx(
        4 * [EI], rel=1e-4
    )
    assert [link.joint.stiffness for link in (shoulder, *booms)] == pytest.approx(springs, rel=1e-4)


def test_the_shuttle_like_arm_has_the_band_it_was_not_tuned_to() -> None:
    """Fifth and sixth published frequencies, within 10 %."""
    assert hertz(ARMS["srms-like"])[4:6] == pytest.approx((14.98, 15.14), rel=0.1)


def test_a_preset_says_tuned_where_it_is() -> None:
    for name in ("quanser-rotary-flexible-link", "sapienza-forearm", "ralf-like", "srms-like"):
        assert "tuned" in ARMS[name].description


def test_the_shuttle_like_arm_stretches_along_x_and_turns_about_the_named_axes() -> None:
    """Yaw about z, three pitch joints about one horizontal axis, roll about the arm's axis."""
    from dynamics.formulations.kinematics import outward, poses
    from dynamics.model import Model

    arm = ARMS["srms-like"]
    model = Model(arm)
    bodies = poses(outward(model.chain, [0.0] * arm.n, [0.0] * arm.n))
    frames = [bodies[place.start] for place in model.bodies]
    axes = [np.array(frame.R)[:, 2] for frame in frames]
    assert_allclose(axes[0], (0.0, 0.0, 1.0), atol=1e-12)
    for pitch in axes[1:4]:
        assert_allclose(pitch, axes[1], atol=1e-12)
        assert abs(pitch[0]) + abs(pitch[2]) < 1e-12
    assert_allclose(np.abs(axes[4]), (0.0, 0.0, 1.0), atol=1e-12)
    assert_allclose(np.abs(axes[5]), (1.0, 0.0, 0.0), atol=1e-12)
    tip = np.array(frames[-1].tip)
    assert tip[0] == pytest.approx(15.316, abs=2e-3)
    assert np.hypot(tip[1], tip[2]) < 0.5
