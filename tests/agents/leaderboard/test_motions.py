"""Motions of an episode under given actions, and their slopes, on systems known by hand."""

from dataclasses import FrozenInstanceError, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agents.leaderboard import motions
from agents.leaderboard.motions import Episode, Motion, effects, plant
from agents.leaderboard.tracks import TRACKS
from dynamics.types import Array
from tests.agents.leaderboard.cart import BAND, RESPONSE, STEPS, Cart

ONE, TWO = "FlexArm/OneLink-Reach-v0", "FlexArm/TwoLink-Reach-v0"


def test_effects_are_the_response_to_every_action() -> None:
    """Exact for a linear system, also where an action is at its limit."""
    cart = Cart()
    forces = np.linspace(-1.0, 1.0, STEPS)[:, None]
    slopes, bends = effects(cart, cart.motion(forces))  # type: ignore[arg-type]
    np.testing.assert_allclose(slopes[:, 0], RESPONSE / BAND, atol=1e-9)
    np.testing.assert_allclose(bends, 0.5 * np.eye(STEPS), atol=1e-9)


def test_rows_of_effects_are_times_and_columns_actions() -> None:
    class Lasting(Cart):
        def motion(self, force: Array) -> Motion:
            return replace(super().motion(force), deflection=np.cumsum(force[:, 0]))

    _, bends = effects(Lasting(), Lasting().resting())  # type: ignore[arg-type]
    np.testing.assert_allclose(bends, np.tril(np.ones((STEPS, STEPS))), atol=1e-9)


def test_effects_are_small_steps_inwards() -> None:
    seen = []

    class Watched(Cart):
        def follow(self, actions: Array) -> list[Motion]:
            seen.append(actions)
            return super().follow(actions)

    forces = np.array([1.0, -1.0, 0.0, *np.full(STEPS - 3, 0.5)])[:, None]
    effects(Watched(), Cart().motion(forces))  # type: ignore[arg-type]
    change = seen[0] - forces
    assert change.shape == (STEPS + 1, STEPS, 1)
    np.testing.assert_allclose(np.diag(change[:-1, :, 0])[:4], [-1e-3, 1e-3, 1e-3, -1e-3])
    assert np.count_nonzero(change) == STEPS


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
