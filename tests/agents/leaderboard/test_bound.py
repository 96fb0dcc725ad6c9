"""The search for the shortest settling time, on a cart whose optimum a linear program gives."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from agents.leaderboard import bound
from agents.leaderboard.tracks import TRACKS
from dynamics.types import Array

ONE, TWO = "FlexArm/OneLink-Reach-v0", "FlexArm/TwoLink-Reach-v0"
DT, STEPS, BAND = 0.1, 40, 0.02
AGE = np.subtract.outer(np.arange(STEPS), np.arange(STEPS))
RESPONSE = np.where(
    AGE >= 0, DT**2 * (AGE + 0.5), 0.0
)  # positions by unit forces on a mass of 1 kg


class Cart:
    """A cart of 1 kg, at rest 1 m before its target; `bend` is the deflection of a unit force."""

    steps, held, dt = STEPS, STEPS - 2, DT

    def __init__(self, bend: Any = 0.5) -> None:
        self.bend = bend

    def follow(self, actions: Array) -> list[bound.Motion]:
        return [self.motion(force) for force in actions]

    def motion(self, force: Array) -> bound.Motion:
        errors = (RESPONSE @ force[:, 0] - 1.0)[:, None] / BAND
        outside = np.flatnonzero(np.abs(errors[:, 0]) >= 1.0)
        return bound.Motion(force, errors, self.bend * force[:, 0], int(outside[-1]) + 1, True)


def first_feasible(largest: float) -> int:
    """First step from which forces of at most `largest` can keep the cart on its target."""
    for k in range(STEPS):
        rows, room = np.vstack([RESPONSE[k:], -RESPONSE[k:]]), np.full(STEPS - k, BAND)
        b = np.concatenate([room + 1.0, room - 1.0])
        if linprog(np.zeros(STEPS), rows, b, bounds=(-largest, largest)).status == 0:
            return k
    raise AssertionError("no step is feasible")


def resting(cart: Cart) -> bound.Motion:
    return cart.follow(np.zeros((1, STEPS, 1)))[0]


def motion(errors: Any, actions: Any = ((0.0,),), bend: Any = 0.0, valid: bool = True) -> Any:
    errors = np.array(errors, float)
    return bound.Motion(np.array(actions, float), errors, np.full(len(errors), bend), 9, valid)


def test_the_search_finds_the_optimum_of_a_linear_system() -> None:
    """By one linear program per step, which knows the system; the search only replays it."""
    best = bound.shortest(Cart(), resting(Cart()))
    assert best.settled == first_feasible(1.0)
    assert np.abs(best.actions).max() <= 1.0
    assert np.abs(best.errors[best.settled :]).max() < 1.0


def test_the_search_keeps_the_deflection_below_its_limit() -> None:
    """The limit holds the pushes, not the pulls, to half the force."""
    best = bound.shortest(Cart(2.0), resting(Cart()))
    assert best.deflection.max() <= 1.0
    assert first_feasible(1.0) < best.settled <= first_feasible(0.5)


def test_a_settled_motion_is_only_ever_improved() -> None:
    cart = Cart()
    best = bound.shortest(cart, resting(cart))
    assert bound.shortest(cart, best).settled == best.settled
    assert bound.improved(cart, best, best.settled) is best
    assert bound.improved(cart, best, best.settled + 1) is best


@pytest.mark.parametrize(
    ("settled", "best", "asked"),
    [
        (8, 8, [6, 7]),  # a quarter earlier, then a step
        (8, 3, [6, 4, 2, 3, 2]),
        (1, 0, [0]),
        (5, 2, [4, 3, 2, 1]),
        (39, 39, [38]),  # not held to the end
        (38, 38, [29, 34, 36, 37]),
    ],
)
def test_the_search_takes_ever_smaller_strides(
    settled: int, best: int, asked: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def improved(episode: Any, motion: bound.Motion, first: int) -> bound.Motion:
        tried.append(first)
        return replace(motion, settled=first) if first >= best else motion

    monkeypatch.setattr(bound, "improved", improved)
    start = replace(motion([[0.5]]), settled=settled)
    assert bound.shortest(Cart(), start).settled == best  # type: ignore[arg-type]
    assert tried == asked


def test_a_search_that_finds_more_than_it_wanted_goes_on_from_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried = []

    def improved(episode: Any, motion: bound.Motion, first: int) -> bound.Motion:
        tried.append(first)
        return replace(motion, settled=3) if first >= 3 else motion

    monkeypatch.setattr(bound, "improved", improved)
    start = replace(motion([[0.5]]), settled=8)
    assert bound.shortest(Cart(), start).settled == 3  # type: ignore[arg-type]
    assert tried == [6, 1, 2]


def test_a_motion_that_never_leaves_the_band_is_given_back() -> None:
    """Nothing is tried, as there is no earlier step."""
    still = motion([[0.5]])
    still = replace(still, settled=0)
    assert bound.shortest(SimpleNamespace(held=1), still) is still  # type: ignore[arg-type]


def test_a_hopeless_episode_is_given_back() -> None:
    """A force of 1 N leaves a target at 100 m out of reach."""

    class Far(Cart):
        def motion(self, force: Array) -> bound.Motion:
            near = super().motion(force)
            return bound.Motion(force, near.errors - 99.0 / BAND, near.deflection, STEPS, True)

    assert bound.shortest(Far(), resting(Far())).settled == STEPS


@pytest.mark.parametrize(("step", "programs"), [(1e-4, 8), (0.0, 3), (-1e-4, 3)])
def test_a_search_ends_after_eight_programs_or_when_the_trust_is_spent(
    step: float, programs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trust 0.5, 0.125, 0.031 without success; 0.0078 is below the last."""
    asked = []

    def program(motion: bound.Motion, *given: Any) -> Array:
        asked.append(given[-1])
        return np.full_like(motion.actions, step)

    monkeypatch.setattr(bound, "program", program)
    found = bound.improved(Cart(), resting(Cart()), 30)
    assert len(asked) == programs
    assert asked == ([0.5] * 8 if step > 0.0 else [0.5, 0.125, 0.03125])
    assert found.actions[0, 0] == pytest.approx(max(step, 0.0) * programs)


def test_a_search_without_a_program_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bound, "program", lambda *given: None)
    start = resting(Cart())
    assert bound.improved(Cart(), start, 30) is start


def test_effects_are_the_response_to_every_action() -> None:
    """Exact for a linear system, also where an action is at its limit."""
    cart = Cart()
    forces = np.linspace(-1.0, 1.0, STEPS)[:, None]
    slopes, bends = bound.effects(cart, cart.motion(forces))
    np.testing.assert_allclose(slopes[:, 0], RESPONSE / BAND, atol=1e-9)
    np.testing.assert_allclose(bends, 0.5 * np.eye(STEPS), atol=1e-9)


def test_rows_of_effects_are_times_and_columns_actions() -> None:
    class Lasting(Cart):
        def motion(self, force: Array) -> bound.Motion:
            return replace(super().motion(force), deflection=np.cumsum(force[:, 0]))

    _, bends = bound.effects(Lasting(), Lasting().motion(np.zeros((STEPS, 1))))
    np.testing.assert_allclose(bends, np.tril(np.ones((STEPS, STEPS))), atol=1e-9)


def test_effects_are_small_steps_inwards() -> None:
    seen = []

    class Watched(Cart):
        def follow(self, actions: Array) -> list[bound.Motion]:
            seen.append(actions)
            return super().follow(actions)

    forces = np.array([1.0, -1.0, 0.0, *np.full(STEPS - 3, 0.5)])[:, None]
    bound.effects(Watched(), Cart().motion(forces))
    change = seen[0] - forces
    assert change.shape == (STEPS + 1, STEPS, 1)
    np.testing.assert_allclose(np.diag(change[:-1, :, 0])[:4], [-1e-3, 1e-3, 1e-3, -1e-3])
    assert np.count_nonzero(change) == STEPS


@pytest.mark.parametrize(("size", "count", "gap"), [(1, 2, 0.0), (2, 16, 0.02), (3, 50, 0.11)])
def test_directions_are_unit_vectors_all_round(size: int, count: int, gap: float) -> None:
    """The polygon around the unit ball lies within `gap` of it, in any direction."""
    found = bound.directions(size)
    assert found.shape == (count, size)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=5e-3)
    assert len({tuple(x) for x in found.round(6)}) == count
    points = np.random.default_rng(0).normal(size=(2000, size))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    assert (points @ found.T).max(axis=1).min() >= 1.0 - gap


def test_the_largest_error_is_that_from_a_step_on() -> None:
    found = motion([[9.0, 0.0], [3.0, 4.0], [1.0, 0.0]])
    assert [bound.largest(found, k) for k in range(3)] == [9.0, 5.0, 1.0]
    assert bound.largest(motion([[0.1]], valid=False), 0) == np.inf


def test_a_program_makes_the_largest_error_as_small_as_the_room_allows() -> None:
    """Errors 3 + a and 1 - a from step 1 on: 2 at a = 1; less far within the trust or the limit."""
    slopes = np.array([[[5.0]], [[1.0]], [[-1.0]]])
    errors = [[50.0], [3.0], [-1.0]]
    still = np.zeros((3, 1))

    def change(action: float, trust: float, bends: Any = still, bend: float = 0.0) -> float:
        found = bound.program(motion(errors, [[action]], bend), slopes, bends, 1, trust)
        assert found is not None
        assert found.shape == (1, 1)
        return float(found[0, 0])

    assert change(0.5, 9.0) == pytest.approx(-1.5)  # to the limit of the action
    assert change(0.5, 0.25) == pytest.approx(-0.25)  # to that of the trust
    assert change(-0.75, 0.5) == pytest.approx(-0.25)
    push = np.array([[0.0], [-1.0], [0.0]])
    assert change(0.5, 9.0, push, 0.5) == pytest.approx(-0.499)  # to 0.999 of the deflection
    over = motion(errors, [[0.0]], 2.0)
    assert bound.program(over, slopes, still, 1, 1.0) is None


def test_a_program_balances_two_errors() -> None:
    """|2 + a| and |0.5 - a| are equal at a = -0.75, and so in the plane."""
    slopes = np.array([[[1.0]], [[-1.0]]])
    found = bound.program(motion([[2.0], [0.5]], [[0.0]]), slopes, np.zeros((2, 1)), 0, 5.0)
    assert found == pytest.approx(np.array([[-0.75]]))
    flat = np.array([[[1.0], [0.0]], [[-1.0], [0.0]]])
    plane = motion([[2.0, 0.0], [0.5, 0.0]], [[0.0]])
    found = bound.program(plane, flat, np.zeros((2, 1)), 0, 5.0)
    assert found == pytest.approx(np.array([[-0.75]]))


class Carts:
    """A batch of carts on a line, with the parts of an environment that an episode reads."""

    reach = 3.125  # [m] so that the band is 1/16 m
    observation_slices = {"tip_error": slice(1, 2)}  # noqa: RUF012
    observation_scales = {"tip_error": 4.0}  # noqa: RUF012
    core = SimpleNamespace(arguments={"deflection_limit": 0.5})

    def __init__(self, count: int) -> None:
        self.count, self.unwrapped = count, self

    def reset(self, seed: list[int]) -> Any:
        self.seed, self.step_number = seed, 0
        self.x = np.full(self.count, float(seed[0]))
        return self.observation(), {}

    def observation(self) -> Array:
        return np.column_stack([np.full(self.count, 7.0), self.x / 4.0])

    def step(self, action: Array) -> Any:
        assert action.dtype == np.float32
        self.step_number += 1
        self.x = self.x - action[:, 0]
        info = {"deflection": 0.25 * action[:, 0], "tip_error": np.abs(self.x)}
        ended = (self.x < -5.0) & (self.step_number == 2)
        return self.observation(), np.zeros(self.count), ended, np.zeros(self.count, bool), info


@pytest.fixture
def episode(monkeypatch: pytest.MonkeyPatch) -> bound.Episode:
    made = []

    def make(env_id: str, count: int, kwargs: Any) -> Carts:
        assert (env_id, kwargs) == (ONE, {"obs": "state"})
        made.append(count)
        assert len(set(made)) == len(made), "made twice"
        return Carts(count)

    monkeypatch.setattr(bound, "make_batch", make)
    return bound.Episode(ONE, {"obs": "state"}, 3, {})


def test_an_episode_is_as_long_as_that_of_its_task(episode: bound.Episode) -> None:
    """3 s of 0.02 s; settling has to begin 0.25 s before the end."""
    assert (episode.steps, episode.dt, episode.held) == (150, 0.02, 138)
    assert bound.Episode(TWO, {}, 0, {}).held == 235


def test_motions_hold_what_the_environment_says(episode: bound.Episode) -> None:
    """From 3 m: to the target in one step, in two and back out for a step, never, and lost."""
    actions = np.zeros((4, 150, 1))
    actions[0, 0], actions[1, :2, 0], actions[1, 100:102, 0] = 3.0, (1.0, 2.0), (1.0, -1.0)
    actions[3, :2, 0] = 4.5
    found = episode.follow(actions)
    assert [m.settled for m in found] == [0, 101, 150, 150]
    assert [m.valid for m in found] == [True, True, True, False]
    band = 1 / 16
    assert found[1].errors[:3, 0] * band == pytest.approx([2.0, 0.0, 0.0])
    assert found[1].deflection[[0, 1, 2, 101]] == pytest.approx([0.5, 1.0, 0.0, -0.5])
    assert found[1].actions is not None
    np.testing.assert_array_equal(found[1].actions, actions[1])
    again = episode.follow(actions)
    np.testing.assert_array_equal(again[1].errors, found[1].errors)


def test_the_edge_of_the_band_is_outside(episode: bound.Episode) -> None:
    actions = np.zeros((2, 150, 1))
    actions[:, 0, 0] = 3.0 - 1 / 16, 3.0 - 15 / 256
    assert [m.settled for m in episode.follow(actions)] == [150, 0]


def test_actions_of_a_controller_are_its_clipped_predictions(episode: bound.Episode) -> None:
    """The state that it returned is given back; the start is said once."""
    given = []

    class Subject:
        def predict(self, observation: Array, state: Any, start: Array) -> Any:
            given.append((observation[0, 1], state, start.tolist()))
            return np.array([[[2.0, -2.0, 0.5][min(len(given), 3) - 1]]], np.float32), len(given)

    actions = episode.acted(Subject())
    assert actions.shape == (150, 1)
    assert actions[:4, 0].tolist() == [1.0, -1.0, 0.5, 0.5]
    assert given[:2] == [(0.75, None, [True]), (0.25, 1, [False])]
    assert list(episode._batches) == [1]


def test_stored_bounds_are_read_by_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bound, "FOLDER", tmp_path / "bounds")
    bound.stored.cache_clear()
    assert bound.shortest_times(ONE, "state", [5]) is None
    bound.stored.cache_clear()
    times = np.array([[0.6, 0.5], [np.inf, 0.7], [np.inf, np.inf]])
    motions = [motion([[0.0]], [[0.25 * k]]) for k in range(3)]
    path = bound.file_of(ONE, "state")
    bound.save(path, [5, 6, 7], motions, times)
    bound.save(path, [5, 6, 7], motions, times)  # the folder is there already
    assert path == tmp_path / "bounds" / "OneLink-Reach-v0.state.npz"
    found = bound.shortest_times(ONE, "state", [6, 5])
    assert found is not None
    assert found.tolist() == [0.7, 0.5]
    assert bound.shortest_times(ONE, "state", [5, 7]) is None  # no bound was found
    assert bound.shortest_times(ONE, "state", [5, 8]) is None
    with np.load(path) as data:
        assert data["actions"].dtype == np.float32
        assert data["actions"][:, 0, 0].tolist() == [0.0, 0.25, 0.5]
        assert data["starts"].tolist() == times.tolist()
    bound.stored.cache_clear()


@pytest.mark.parametrize(
    ("seeds", "words"),
    [(np.array([5, 6]), "zip"), (np.array([5], dtype=object), "allow_pickle=False")],
)
def test_damaged_bounds_are_refused(
    seeds: Any, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More seeds than times; objects, which could run code."""
    monkeypatch.setattr(bound, "FOLDER", tmp_path)
    bound.stored.cache_clear()
    np.savez(bound.file_of(ONE, "state"), seeds=seeds, times=np.array([0.5]))
    with pytest.raises(ValueError, match=words):
        bound.stored(ONE, "state")
    bound.stored.cache_clear()


def test_agreement_is_a_twentieth_of_the_shorter_time() -> None:
    times = np.array([[20.0, 21.0], [2.0, 2.2], [3.0, 3.0], [4.0, 4.0]])
    assert bound._agreement(times) == "median 3.500 s; starts agree within 5 % in 75%"


def test_plants_of_a_track_have_its_payload_and_stiffness_alone() -> None:
    """And an exact observation, with neither noise nor delay."""
    assert bound.plant(ONE, "state") == {"obs": "state"}
    found = bound.plant(ONE, "laboratory")
    assert set(found) == {"obs", "randomize"}
    assert found["obs"] == "state"
    assert found["randomize"]
    assert TRACKS["laboratory"].kwargs["hardware"] == "laboratory"
