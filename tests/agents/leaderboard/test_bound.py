"""The search for the best that torques reach, on a cart whose optima other solvers give."""

from dataclasses import FrozenInstanceError, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from agents.leaderboard import bound
from agents.leaderboard.bound import Aim
from agents.leaderboard.motions import Motion
from dynamics.types import Array
from tests.agents.leaderboard.cart import BAND, DT, RESPONSE, STEPS, Cart, first_feasible

TRACK = "FlexArm/OneLink-Track-v0"
TIMES = DT * np.arange(1, STEPS + 1)


def motion(errors: Any, actions: Any = ((0.0,),), bend: Any = 0.0, valid: bool = True) -> Motion:
    errors = np.array(errors, float)
    length, bends = np.linalg.norm(errors, axis=1), np.full(len(errors), bend)
    return Motion(np.array(actions, float), errors, length, bends, 9, valid)


def test_the_search_finds_the_optimum_of_a_linear_system() -> None:
    """By a linear program per step, which knows the system; the search only replays it."""
    best = bound.shortest(Cart(), Cart().resting())  # type: ignore[arg-type]
    assert best.settled == first_feasible(1.0)
    assert np.abs(best.actions).max() <= 1.0
    assert np.abs(best.errors[best.settled :]).max() < 1.0


def test_the_search_keeps_the_deflection_below_its_limit() -> None:
    """The limit holds the pushes, not the pulls, to half the force."""
    best = bound.shortest(Cart(bend=2.0), Cart().resting())  # type: ignore[arg-type]
    assert best.deflection.max() <= 1.0
    assert first_feasible(1.0) < best.settled <= first_feasible(0.5)


@pytest.mark.parametrize("period", [2.0, 0.9])
def test_the_search_finds_the_smallest_rms_of_a_linear_system(period: float) -> None:
    """By bounded least squares, which knows the system; the force is too weak for the path."""
    path = 0.2 * np.sin(2.0 * np.pi * TIMES / period)
    exact = lsq_linear(RESPONSE / BAND, path / BAND, bounds=(-1.0, 1.0), tol=1e-12)
    assert np.abs(exact.x).max() > 0.999
    cart = Cart(path)
    found = bound.improved(cart, cart.resting(), Aim())  # type: ignore[arg-type]
    assert found.rms == pytest.approx(np.sqrt(2.0 * exact.cost / STEPS), rel=0.01)
    assert np.abs(found.actions).max() <= 1.0


def test_a_settled_motion_is_only_ever_improved() -> None:
    cart: Any = Cart()
    best = bound.shortest(cart, cart.resting())
    assert bound.shortest(cart, best).settled == best.settled
    assert bound.improved(cart, best, Aim(best.settled, 1.0)) is best
    assert bound.improved(cart, best, Aim(best.settled + 1, 1.0)) is best


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

    def improved(episode: Any, motion: Motion, aim: Aim) -> Motion:
        tried.append((aim.first, aim.band))
        return replace(motion, settled=aim.first) if aim.first >= best else motion

    monkeypatch.setattr(bound, "improved", improved)
    start = replace(motion([[0.5]]), settled=settled)
    assert bound.shortest(Cart(), start).settled == best  # type: ignore[arg-type]
    assert tried == [(first, 1.0) for first in asked]


def test_a_search_that_finds_more_than_it_wanted_goes_on_from_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried = []

    def improved(episode: Any, motion: Motion, aim: Aim) -> Motion:
        tried.append(aim.first)
        return replace(motion, settled=3) if aim.first >= 3 else motion

    monkeypatch.setattr(bound, "improved", improved)
    start = replace(motion([[0.5]]), settled=8)
    assert bound.shortest(Cart(), start).settled == 3  # type: ignore[arg-type]
    assert tried == [6, 1, 2]


def test_a_motion_that_fails_is_no_improvement(monkeypatch: pytest.MonkeyPatch) -> None:
    def improved(episode: Any, motion: Motion, aim: Aim) -> Motion:
        return replace(motion, settled=0, valid=False)

    monkeypatch.setattr(bound, "improved", improved)
    start = replace(motion([[0.5]]), settled=8)
    assert bound.shortest(Cart(), start) is start  # type: ignore[arg-type]


def test_a_motion_that_never_leaves_the_band_is_given_back() -> None:
    """Nothing is tried, as there is no earlier step."""
    still = replace(motion([[0.5]]), settled=0)
    assert bound.shortest(SimpleNamespace(held=1), still) is still  # type: ignore[arg-type]


def test_a_hopeless_episode_stays_unsettled() -> None:
    """A force of 1 N leaves a target at 100 m out of reach."""
    far: Any = Cart(100.0)
    assert bound.shortest(far, far.resting()).settled == STEPS


@pytest.mark.parametrize(("step", "programs"), [(1e-4, 12), (0.0, 3), (-1e-4, 3)])
def test_a_search_ends_after_twelve_programs_or_when_the_trust_is_spent(
    step: float, programs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trust 0.5, 0.125, 0.031 without success; 0.0078 is below the last."""
    asked = []

    def program(motion: Motion, slopes: Array, bends: Array, aim: Aim, trust: float) -> Array:
        assert aim == Aim(30, 1.0)
        asked.append(trust)
        return np.full_like(motion.actions, step)

    monkeypatch.setattr(bound, "program", program)
    found = bound.improved(Cart(), Cart().resting(), Aim(30, 1.0))  # type: ignore[arg-type]
    assert asked == ([0.5] * 12 if step > 0.0 else [0.5, 0.125, 0.03125])
    assert found.actions[0, 0] == pytest.approx(max(step, 0.0) * programs)


@pytest.mark.parametrize(("gains", "programs"), [([0.5, 0.98, 0.995, 0.5], 3), ([1.0, 0.5], 4)])
def test_a_search_without_a_band_ends_at_a_gain_below_a_hundredth(
    gains: list[float], programs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last gain counts; a program without any gain only shrinks the trust."""
    asked = []

    class Halving(Cart):
        def follow(self, actions: Array) -> list[Motion]:
            return [replace(motion([[float(actions[0, 0, 0])]]), actions=actions[0])]

        def effects(self, motion: Motion) -> Any:
            return None, None

    def program(motion: Motion, *given: Any) -> Array:
        asked.append(given[-1])
        gain = gains[len(asked) - 1] if len(asked) <= len(gains) else 1.0
        return np.asarray((gain - 1.0) * motion.actions)

    monkeypatch.setattr(bound, "program", program)
    found = bound.improved(Halving(), motion([[8.0]], [[8.0]]), Aim())  # type: ignore[arg-type]
    assert len(asked) == programs
    assert found.rms == pytest.approx(8.0 * np.prod(gains[:programs]))


def test_the_loss_of_a_band_is_the_largest_distance_from_a_step_on() -> None:
    found = motion([[9.0, 0.0], [3.0, 4.0], [1.0, 0.0]])
    assert [Aim(k, 1.0).loss(found) for k in range(3)] == [9.0, 5.0, 1.0]
    assert Aim().loss(found) == pytest.approx(np.sqrt((81.0 + 25.0 + 1.0) / 3.0))
    lost = motion([[0.1]], valid=False)
    assert Aim(0, 1.0).loss(lost) == Aim().loss(lost) == np.inf


def test_an_aim_is_met_by_a_valid_motion_that_settles_in_time() -> None:
    """Without a band there is always something left to do."""
    found = motion([[0.5]])
    assert [Aim(k, 1.0).met(found) for k in (8, 9, 10)] == [False, True, True]
    assert not Aim(10, 1.0).met(replace(found, valid=False))
    assert not Aim(10).met(found)
    with pytest.raises(FrozenInstanceError):
        Aim().first = 1  # type: ignore[misc]


STILL = np.zeros((3, 1))


def change(
    action: float, trust: float, bends: Array = STILL, bend: float = 0.0, band: float = 1.0
) -> float:
    """Change by a program of an action that moves the errors 3 + a and -0.5 - a after the first."""
    start = motion([[50.0], [3.0], [-0.5]], [[action]], bend)
    slopes = np.array([[[5.0]], [[1.0]], [[-1.0]]])
    found = bound.program(start, slopes, bends, Aim(1, band), trust)
    assert found.shape == (1, 1)
    return float(found[0, 0])


def test_a_program_minimises_the_squared_excess_over_the_band() -> None:
    """Over 0.97 of the band: (2.03 + a)^2 + (-1.47 - a)^2 is least at a = -1.75."""
    assert change(1.0, 9.0) == pytest.approx(-1.75, abs=1e-6)
    assert change(0.5, 9.0) == pytest.approx(-1.5)  # to the limit of the action
    assert change(0.5, 0.25) == pytest.approx(-0.25)  # to that of the trust
    assert change(-0.75, 0.5) == pytest.approx(-0.25)
    start = motion([[3.0], [1.0]], [[0.9]])
    slopes = np.array([[[1.0]], [[-1.0]]])
    found = bound.program(start, slopes, np.zeros((2, 1)), Aim(0, 1.0), 9.0)
    assert found[0, 0] == pytest.approx(-1.0, abs=1e-6)  # (2.03 + a)^2 + (0.03 - a)^2
    found = bound.program(start, slopes, np.zeros((2, 1)), Aim(1, 1.0), 9.0)
    assert 0.03 <= found[0, 0] <= 0.1  # the second alone: anywhere in the band


def test_a_program_without_a_band_minimises_the_squares() -> None:
    """(2 + a)^2 + (0.5 - a)^2 at a = -0.75, and so in the plane."""
    slopes, aim = np.array([[[1.0]], [[-1.0]]]), Aim()
    found = bound.program(motion([[2.0], [0.5]], [[0.0]]), slopes, np.zeros((2, 1)), aim, 5.0)
    assert found == pytest.approx(np.array([[-0.75]]), abs=1e-6)
    flat = np.array([[[1.0], [0.0]], [[-1.0], [0.0]]])
    plane = motion([[2.0, 7.0], [0.5, 0.0]], [[0.0]])
    found = bound.program(plane, flat, np.zeros((2, 1)), aim, 5.0)
    assert found == pytest.approx(np.array([[-0.75]]), abs=1e-6)


def test_errors_in_the_plane_are_judged_by_their_length() -> None:
    """sqrt((3 + 5 a)^2 + 16) - 0.97 is least at a = -0.6; two joints, of which one does nothing."""
    start = motion([[3.0, 4.0]], [[0.0, 0.0]])
    slopes = 5.0 * np.array([[[1.0, 0.0], [0.0, 0.0]]])
    found = bound.program(start, slopes, np.zeros((1, 2)), Aim(0, 1.0), 5.0)
    assert found == pytest.approx(np.array([[-0.6, 0.0]]), abs=1e-6)


def test_a_program_pays_for_the_excess_over_the_deflection_limit() -> None:
    """30 times: (2.03 + a)^2 + 30^2 (0.5 - a - 0.97)^2 is least where 901 a = -425.03."""
    push = np.array([[0.0], [-1.0], [0.0]])
    assert change(1.0, 9.0, push, 0.5) == pytest.approx(-425.03 / 901.0, abs=1e-6)
    assert change(1.0, 0.5, 2.0 * push, 0.5) == pytest.approx(-848.03 / 3601.0, abs=1e-6)
    assert change(1.0, 9.0, -push, 0.5) == pytest.approx(-1.75, abs=1e-6)  # away from the limit
    assert change(1.0, 0.25, push, 0.5) == pytest.approx(-0.25)
    assert change(0.0, 1.0, push, 0.99, band=100.0) >= 0.02  # anywhere below it


def test_an_error_of_zero_has_no_pull() -> None:
    start, slopes = motion([[0.0], [2.0]], [[0.0]]), np.array([[[0.0]], [[4.0]]])
    found = bound.program(start, slopes, np.zeros((2, 1)), Aim(), 9.0)
    assert found[0, 0] == pytest.approx(-0.5, abs=1e-6)


def test_a_program_spares_the_actions() -> None:
    """(0.005 + 0.01 a)^2 + 1e-7 a^2 is least at a = -0.5 / 1.001."""
    start = motion([[0.005]], [[0.0]])
    found = bound.program(start, np.array([[[0.01]]]), np.zeros((1, 1)), Aim(), 9.0)
    assert found[0, 0] == pytest.approx(-0.5 / 1.001, abs=1e-5)


def test_the_best_of_a_path_is_the_rms_of_the_start_and_all_steps() -> None:
    """In metres, of bands of 2 % of the reach of 2 m."""
    found, moving = motion([[3.0], [-4.0]]), SimpleNamespace(env_id=TRACK, reach=2.0, start=5.0)
    assert bound.reached(moving, found) == pytest.approx(0.04 * (50.0 / 3.0) ** 0.5)  # type: ignore[arg-type]
    assert bound.reached(moving, replace(found, valid=False)) == np.inf  # type: ignore[arg-type]
    assert [bound.is_moving(x) for x in (Cart.env_id, TRACK)] == [False, True]


@pytest.mark.parametrize(
    ("start", "settled", "time"),
    [(0.5, 0, 0.0), (1.0, 0, 0.1), (50.0, 0, 0.1), (0.5, 1, 0.2), (50.0, 9, 1.0),
     (50.0, 38, 3.9), (50.0, 39, np.inf)],
)  # fmt: skip
def test_the_best_of_a_target_at_rest_is_the_time_when_it_was_reached(
    start: float, settled: int, time: float
) -> None:
    """The first step ends after 0.1 s; it must be held from step 38 at the latest."""
    rest: Any = Cart(start * BAND)
    found = replace(motion([[3.5], [-3.5]]), settled=settled)
    assert bound.reached(rest, found) == pytest.approx(time)
    assert bound.reached(rest, replace(found, valid=False)) == np.inf


@pytest.mark.parametrize("env_id", [Cart.env_id, TRACK])
def test_every_start_is_improved_and_the_best_is_kept(
    env_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The start of the first controller fails, and resting takes its place."""
    seen: list[Any] = []

    class Acted(Cart):
        def __init__(self, *given: Any) -> None:
            super().__init__()
            self.env_id, self.given = env_id, given

        def batch(self, count: int) -> Any:
            return [f"batch of {count}"]

        def acted(self, subject: Any) -> Array:
            assert subject[1:] == ("batch of 1", (subject[0], env_id, "state"))
            return np.full((STEPS, 1), -0.5 if subject[0] == "pd" else 0.25)

        def motion(self, force: Array) -> Motion:
            return replace(super().motion(force), valid=bool(force[0, 0] <= 0.0))

    def search(episode: Any, motion: Motion, aim: Any = None) -> Motion:
        seen.append((float(motion.actions[0, 0]), aim, episode.given))
        better = 10 + 10 * (len(seen) == 1)
        return replace(motion, settled=better, distance=np.full(STEPS, float(better)))

    monkeypatch.setattr(bound, "Episode", Acted)
    monkeypatch.setattr(bound, "controller", lambda *given: given)
    monkeypatch.setattr(bound, "parameters_of", lambda *given: given)
    monkeypatch.setattr(bound, "improved" if env_id == TRACK else "shortest", search)
    batches: dict[int, Any] = {}
    found, starts = bound.bounded(env_id, "state", 7, batches)
    given = (env_id, {"obs": "state"}, 7, batches)
    aim = Aim() if env_id == TRACK else None
    assert seen == [(0.0, aim, given), (-0.5, aim, given)]
    rms = [np.sqrt((50.0**2 + STEPS * x**2) / (STEPS + 1)) * BAND for x in (20.0, 10.0)]
    assert starts == pytest.approx(rms if env_id == TRACK else [2.1, 1.1])
    assert found.settled == 10
    _, starts = bound.bounded(env_id, "state", 7, batches, np.full((STEPS, 1), -0.25))
    assert [force for force, *_ in seen[2:]] == [0.0, -0.5, -0.25]
    assert len(starts) == 3
