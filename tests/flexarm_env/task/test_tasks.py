"""Tasks: their ranges by hand, and the words in which pages give them."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from dynamics import Arm, Base, Link
from flexarm_env.task.tasks import (
    SETTLED_BAND,
    TASKS,
    Task,
    base_poses,
    find_task,
    refuse_floating,
)

PLAIN = Task(title="t", description="d", start=(-1.0, 2.0), start_text="s", reward="reach")


def test_ranges_are_those_of_the_task_in_the_order_of_an_episode() -> None:
    """Start, moves, share, tempo in units of pi / move time, shake."""
    task = dataclasses.replace(
        PLAIN, moves=(0.1, 0.2), share=(0.3, 0.4), tempo=(0.5, 0.75), shake=(-0.6, 0.7)
    )
    expected = [
        [-1.0, 2.0],
        [0.1, 0.2],
        [0.3, 0.4],
        [0.5 * np.pi / 2.0, 0.75 * np.pi / 2.0],
        [-0.6, 0.7],
    ]
    np.testing.assert_allclose(task.ranges(2.0), expected, rtol=1e-15)


def test_a_task_without_more_moves_nothing() -> None:
    assert not PLAIN.moving
    assert PLAIN.ranges(3.0).tolist() == [[-1.0, 2.0], [0, 0], [0, 0], [0, 0], [0, 0]]


def test_a_target_moves_if_its_fastest_sine_does() -> None:
    assert dataclasses.replace(PLAIN, tempo=(0.0, 0.5)).moving
    assert not dataclasses.replace(PLAIN, shake=(-1.0, 1.0), moves=(1.0, 1.0)).moving


def test_tasks_have_their_ranges() -> None:
    """A change of a task has to be meant: it needs a new version of its ids."""
    move_time = np.pi
    none = [0.0, 0.0]
    assert TASKS["Reach"].ranges(move_time).tolist() == [[-0.5, 0.5], [0.3, 0.8], none, none, none]
    track = [[-0.3, 0.3], none, [0.15, 0.35], [0.4, 1.2], none]
    assert TASKS["Track"].ranges(move_time).tolist() == track
    assert TASKS["Damp"].ranges(move_time).tolist() == [[-0.5, 0.5], none, none, none, [-0.6, 0.6]]
    assert SETTLED_BAND == 0.02


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Reach", ["within 0.5 rad", "joint 0.3 to 0.8 rad away"]),
        ("Track", ["within 0.3 rad", "0.4 to 1.2 times pi", ": 15 to 35 % of the acceleration"]),
        ("Damp", ["within 60 % of", "within 0.5 rad", "up to 10 times the first frequency"]),
    ],
)
def test_pages_give_the_ranges_of_the_start(name: str, words: list[str]) -> None:
    assert all(part in TASKS[name].start_text for part in words)


def test_tasks_are_found_by_name() -> None:
    assert find_task("Damp") is TASKS["Damp"]
    with pytest.raises(ValueError, match="Reach"):
        find_task("Reech")


def floating(**base: Any) -> Arm:
    return Arm(links=(Link(length=1.0, rho_A=1.0, modes=()),), base=Base(**base))


PLANAR = floating(type="planar", mass=2.0, inertia=np.eye(3), position=(0.3, -0.2, 0.0))


def test_a_floating_base_starts_at_its_place_at_any_angle() -> None:
    expected = [[0.3, 0.3], [-0.2, -0.2], [-np.pi, np.pi]]
    np.testing.assert_allclose(base_poses(PLANAR.base), expected, atol=1e-15)
    assert base_poses(Base()).shape == (0, 2)


@pytest.mark.parametrize("name", ["Track", "Damp"])
def test_an_arm_that_floats_neither_follows_a_path_nor_starts_in_vibration(name: str) -> None:
    with pytest.raises(ValueError, match=r"Base\.type must be 'fixed' .* got 'planar'"):
        refuse_floating(TASKS[name], PLANAR)
    refuse_floating(TASKS[name], floating())
    refuse_floating(TASKS["Reach"], PLANAR)


def test_tasks_are_fixed_and_named() -> None:
    """No field may be set later, or given by its place."""
    with pytest.raises(dataclasses.FrozenInstanceError):
        TASKS["Reach"].moves = (1.0, 2.0)  # type: ignore[misc]
    with pytest.raises(TypeError):
        Task("t", "d", (0.0, 1.0), "s", "reach")  # type: ignore[misc]
