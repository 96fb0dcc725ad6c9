"""Motions of an episode under given actions, and their slopes, on systems known by hand."""

from dataclasses import FrozenInstanceError
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.leaderboard import motions
from agents.leaderboard.motions import Episode, Motion, plant
from agents.leaderboard.tracks import TRACKS
from dynamics.types import Array

ONE, TWO = "FlexArm/OneLink-Reach-v0", "FlexArm/TwoLink-Reach-v0"


def test_effects_are_the_derivatives_of_all_steps_chained() -> None:
    """Of steps that are random matrices: by differences of the linear system that they make."""
    steps, size, seen, m = 4, 3, 2, 2
    each = np.random.default_rng(0).normal(size=(steps, size + seen + 1, size + m))

    def moved(actions: Array) -> Array:
        memory, rows = np.zeros(size), []
        for own, action in zip(each, actions, strict=True):
            reached = own @ np.concatenate([memory, action])
            memory = reached[:size]
            rows.append(reached[size:])
        return np.array(rows)

    known: Any = SimpleNamespace(_steps=lambda motion: each)
    slopes, bends = Episode.effects(known, SimpleNamespace(actions=np.zeros((steps, m))))  # type: ignore[arg-type]
    units = np.eye(steps * m).reshape(-1, steps, m)
    expected = np.stack([moved(unit) for unit in units], axis=-1)
    np.testing.assert_allclose(slopes, expected[:, :-1], atol=1e-12)
    np.testing.assert_allclose(bends, expected[:, -1], atol=1e-12)


def test_rms_is_that_of_all_steps() -> None:
    found = Motion(np.zeros((2, 1)), np.zeros((2, 2)), np.array([3.0, 4.0]), np.zeros(2), 2, True)
    assert found.rms == pytest.approx(12.5**0.5)
    with pytest.raises(FrozenInstanceError):
        found.settled = 0  # type: ignore[misc]


class Carts:
    """A batch of carts on a line, with the parts of an environment that an episode reads.

    The observation is 1/16 m too far; judged is the true distance.
    """

    reach = 3.125  # [m] so that the band is 1/16 m
    observation_slices = {"tip_error": slice(1, 2)}  # noqa: RUF012
    observation_scales = {"tip_error": 4.0}  # noqa: RUF012
    core = SimpleNamespace(arguments={"deflection_limit": 0.5})

    def __init__(self, count: int) -> None:
        self.count, self.unwrapped = count, self

    def reset(self, seed: list[int]) -> Any:
        assert len(seed) == self.count
        self.seed, self.step_number = seed, 0
        self.x = np.full(self.count, float(seed[0]))
        return self.observation(), {"tip_error": np.abs(self.x)}

    def observation(self) -> Array:
        return np.column_stack([np.full(self.count, 7.0), (self.x + 1 / 16) / 4.0])

    def step(self, action: Array) -> Any:
        assert action.dtype == np.float32
        self.step_number += 1
        self.x = self.x - action[:, 0]
        info = {"deflection": 0.25 * action[:, 0], "tip_error": np.abs(self.x)}
        ended = (self.x < -5.0) & (self.step_number == 2)
        return self.observation(), np.zeros(self.count), ended, np.zeros(self.count, bool), info


@pytest.fixture
def episode(monkeypatch: pytest.MonkeyPatch) -> Episode:
    made = []

    def make(env_id: str, count: int, kwargs: Any) -> Carts:
        made.append((env_id, count, *kwargs.items()))
        assert len(set(made)) == len(made), "made twice"
        return Carts(count)

    monkeypatch.setattr(motions, "make_batch", make)
    found = Episode(ONE, {"obs": "state"}, 3, {})
    assert made == [(ONE, 1, ("obs", "state"))]
    return found


def test_an_episode_is_as_long_as_that_of_its_task(episode: Episode) -> None:
    """3 s of 0.02 s; the step before 2.74 s is the last that leaves 0.25 s."""
    assert (episode.steps, episode.dt, episode.held) == (150, 0.02, 136)
    assert (episode.env_id, episode.seed, episode.reach) == (ONE, 3, 3.125)
    assert episode.start == pytest.approx(48.0)
    assert Episode(TWO, {}, 0, {}).held == 234


def test_batches_are_kept_for_the_next_episode(episode: Episode) -> None:
    """Making one twice fails in the fixture; every environment has the seed of the episode."""
    kept: dict[int, Any] = {}
    first, second = (Episode(TWO, {}, seed, kept) for seed in (1, 2))
    envs, _ = first.batch(4)
    assert (list(kept), envs.seed) == ([1, 4], [1] * 4)
    assert second.batch(4)[0] is envs
    assert envs.seed == [2] * 4


def test_motions_hold_what_the_environment_says(episode: Episode) -> None:
    """From 3 m: to the target in one step, in two and back out for a step, never, and lost."""
    actions = np.zeros((4, 150, 1))
    actions[0, 0], actions[1, :2, 0], actions[1, 100:102, 0] = 3.0, (1.0, 2.0), (1.0, -1.0)
    actions[3, :2, 0] = 4.5
    found = episode.follow(actions)
    assert [m.settled for m in found] == [0, 101, 150, 150]
    assert [m.valid for m in found] == [True, True, True, False]
    assert found[1].distance[:3] == pytest.approx([32.0, 0.0, 0.0])
    assert found[1].errors[:3] == pytest.approx(np.array([[33.0], [1.0], [1.0]]))
    assert found[1].deflection[[0, 1, 2, 101]] == pytest.approx([0.5, 1.0, 0.0, -0.5])
    np.testing.assert_array_equal(found[1].actions, actions[1])
    again = episode.follow(actions)
    np.testing.assert_array_equal(again[1].errors, found[1].errors)


def test_the_edge_of_the_band_is_outside(episode: Episode) -> None:
    actions = np.zeros((2, 150, 1))
    actions[:, 0, 0] = 3.0 - 1 / 16, 3.0 - 15 / 256
    assert [m.settled for m in episode.follow(actions)] == [150, 0]


def test_actions_of_a_controller_are_its_clipped_predictions(episode: Episode) -> None:
    """The state that it returned is given back; the start is said once."""
    given = []

    class Subject:
        def predict(self, observation: Array, state: Any, start: Array) -> Any:
            given.append((observation[0, 1], state, start.tolist()))
            return np.array([[[2.0, -2.0, 0.5][min(len(given), 3) - 1]]], np.float32), len(given)

    actions = episode.acted(Subject())
    assert actions.shape == (150, 1)
    assert actions[:4, 0].tolist() == [1.0, -1.0, 0.5, 0.5]
    assert given[:2] == [(49 / 64, None, [True]), (17 / 64, 1, [False])]


def test_plants_of_a_track_have_its_payload_and_stiffness_alone() -> None:
    """And an exact observation, with neither noise nor delay."""
    assert plant(ONE, "state") == {"obs": "state"}
    found = plant(ONE, "laboratory")
    assert set(found) == {"obs", "randomize"}
    assert found["obs"] == "state"
    assert found["randomize"]
    assert TRACKS["laboratory"].kwargs["hardware"] == "laboratory"
