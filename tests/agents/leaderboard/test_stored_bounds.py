"""Bounds in their files: added one by one, read by seed, replayed, refused when damaged."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.leaderboard import bound
from agents.leaderboard.bound import Bounds, add, best_of, compute, file_of, stored
from agents.leaderboard.motions import Motion
from tests.agents.leaderboard.cart import STEPS, Cart

REACH, TRACK = "FlexArm/OneLink-Reach-v0", "FlexArm/OneLink-Track-v0"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(bound, "FOLDER", tmp_path / "bounds")
    stored.cache_clear()
    yield tmp_path / "bounds"
    stored.cache_clear()


def pushed(force: float) -> Motion:
    """A cart under a force that is pushed and pulled back at once."""
    return Cart().motion(np.array([[force], [-force], *np.zeros((STEPS - 2, 1))]))


def read(env_id: str, track: str) -> Bounds:
    found = stored(env_id, track)
    assert found is not None
    return found


def test_episodes_are_added_one_by_one_in_the_order_of_their_seeds(folder: Path) -> None:
    for seed, starts in ((7, [np.inf, np.inf]), (5, [0.6, 0.5]), (6, [np.inf, 0.7])):
        add(REACH, "state", seed, pushed(0.125 * seed), starts)
    assert file_of(REACH, "state") == folder / "OneLink-Reach-v0.state.npz"
    assert [path.name for path in folder.iterdir()] == ["OneLink-Reach-v0.state.npz"]
    found = read(REACH, "state")
    assert found.seeds.tolist() == [5, 6, 7]
    assert found.best.tolist() == [0.5, 0.7, np.inf]
    assert found.starts.tolist() == [[0.6, 0.5], [np.inf, 0.7], [np.inf, np.inf]]
    assert found.actions.shape == (3, STEPS, 1)
    assert found.actions.dtype == np.float32
    assert found.actions[:, 0, 0].tolist() == [0.625, 0.75, 0.875]
    assert stored(REACH, "laboratory") is None


def test_an_episode_that_is_added_again_replaces_its_bound() -> None:
    for seed, time in ((5, 0.5), (6, 0.6), (5, 0.4)):
        add(REACH, "state", seed, pushed(time), [time, 0.9])
    found = read(REACH, "state")
    assert found.seeds.tolist() == [5, 6]
    assert found.best.tolist() == [0.4, 0.6]
    assert found.actions[:, 0, 0] == pytest.approx([0.4, 0.6])


def test_an_episode_is_added_to_what_another_process_wrote() -> None:
    """The file counts, not what was read of it before."""
    add(REACH, "state", 5, pushed(0.5), [0.5, 0.9])
    early = file_of(REACH, "state").read_bytes()
    add(REACH, "state", 6, pushed(0.5), [0.5, 0.9])
    late = file_of(REACH, "state").read_bytes()
    file_of(REACH, "state").write_bytes(early)
    stored.cache_clear()
    assert read(REACH, "state").seeds.tolist() == [5]
    file_of(REACH, "state").write_bytes(late)
    add(REACH, "state", 7, pushed(0.5), [0.5, 0.9])
    assert read(REACH, "state").seeds.tolist() == [5, 6, 7]


def test_best_is_known_of_stored_episodes_that_reach_something() -> None:
    """Not of seed 7, from which nothing was reached, nor of seed 8, which is not stored."""
    assert best_of(REACH, "state", [5, 6]) is None
    stored.cache_clear()
    for seed, best in ((5, 0.5), (6, 0.7), (7, np.inf), (9, 0.0)):
        add(REACH, "state", seed, pushed(0.5), [best, np.inf])
        add(TRACK, "laboratory", seed, pushed(0.5), [0.01 * best, np.inf])
    found = best_of(REACH, "state", [6, 7, 9, 8, 5])
    assert found is not None
    assert found.metric == "settling_time"
    np.testing.assert_array_equal(found.values, [0.7, np.nan, 0.0, np.nan, 0.5])
    moving = best_of(TRACK, "laboratory", [5, 6])
    assert moving is not None
    assert moving.metric == "tip_error_rms"
    assert moving.values.tolist() == pytest.approx([0.005, 0.007])


@pytest.mark.parametrize("seeds", [[5], [5, 8], [5, 7], [5, 9], [8]])
def test_best_of_less_than_two_episodes_is_none(seeds: list[int]) -> None:
    """9 is settled from the start, of which no regret can be told."""
    for seed, best in ((5, 0.5), (6, 0.7), (7, np.inf), (9, 0.0)):
        add(REACH, "state", seed, pushed(0.5), [best, np.inf])
    assert best_of(REACH, "state", [5, 6]) is not None
    assert best_of(REACH, "state", seeds) is None


def test_a_folder_adds_its_bounds_to_those_of_the_package(folder: Path, tmp_path: Path) -> None:
    """The better one counts where both have an episode; the package's stay as they are."""
    own = tmp_path / "out" / "bounds"
    for seed, best, place in ((5, 0.5, None), (6, 0.6, None), (6, 0.4, own), (5, 0.7, own)):
        add(REACH, "state", seed, pushed(best), [best, np.inf], place)
    add(REACH, "state", 7, pushed(0.3), [0.3, np.inf], own)
    assert read(REACH, "state").best.tolist() == [0.5, 0.6]
    found = bound.known(REACH, "state", own)
    assert {seed: best for seed, (best, _) in found.items()} == {5: 0.5, 6: 0.4, 7: 0.3}
    assert found[6][1][0, 0] == pytest.approx(0.4)
    best = best_of(REACH, "state", [7, 8, 6], own)
    assert best is not None
    np.testing.assert_array_equal(best.values, [0.3, np.nan, 0.4])
    assert best_of(REACH, "state", [7, 8, 6]) is None
    assert [path.name for path in own.iterdir()] == ["OneLink-Reach-v0.state.npz"]


def test_only_episodes_without_a_bound_are_searched(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    searched, workers = [], []

    def pool(jobs: int) -> ThreadPoolExecutor:
        workers.append(jobs)
        return ThreadPoolExecutor(jobs)

    def search(env_id: str, track: str, seed: int, before: Any) -> Any:
        assert before is None
        searched.append((env_id, track, seed))
        return pushed(0.125 * seed), [0.25 * seed, np.inf]

    monkeypatch.setattr(bound, "workers", pool)
    monkeypatch.setattr(bound, "_searched", search)
    compute(REACH, "state", [3, 2])
    compute(REACH, "state", range(5), jobs=2)
    compute(REACH, "state", range(5))
    assert workers == [1, 2, 1]
    assert sorted(searched) == [(REACH, "state", seed) for seed in range(5)]
    found = read(REACH, "state")
    assert found.seeds.tolist() == [0, 1, 2, 3, 4]
    assert found.best.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert found.actions[:, 0, 0].tolist() == [0.0, 0.125, 0.25, 0.375, 0.5]
    assert f"{REACH}, state, bound 2 of 2, seed 2: from mpc 0.5, pd inf" in capsys.readouterr().out


def test_a_search_again_starts_from_what_is_stored_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def search(env_id: str, track: str, seed: int, before: Any) -> Any:
        if before is None:
            return pushed(0.0), [3.0, 2.0]
        assert before.tolist() == pushed(0.25).actions.tolist()
        return pushed(0.5), [3.0, 2.0, 1.0]

    monkeypatch.setattr(bound, "workers", ThreadPoolExecutor)
    monkeypatch.setattr(bound, "_searched", search)
    add(REACH, "state", 1, pushed(0.25), [0.5, np.inf])
    assert bound.main(["--tasks", REACH, "--seed", "1", "--episodes", "2", "--again"]) == 0
    found = read(REACH, "state")
    assert (found.seeds.tolist(), found.best.tolist()) == ([1, 2], [1.0, 2.0])
    assert found.starts.tolist() == [[3.0, 2.0], [3.0, 2.0]]
    assert found.actions[:, 0, 0].tolist() == [0.5, 0.0]
    assert "seed 1: from mpc 3, pd 2, stored 1" in capsys.readouterr().out


def test_bounds_go_to_a_folder_of_ones_own(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Episodes that have a bound in the package are not searched."""
    monkeypatch.setattr(bound, "workers", ThreadPoolExecutor)
    monkeypatch.setattr(bound, "_searched", lambda *given: (pushed(0.5), [1.0, 2.0]))
    add(REACH, "state", 1, pushed(0.25), [0.5, np.inf])
    own = ["--tasks", REACH, "--seed", "1", "--episodes", "2", "--out", str(tmp_path / "own")]
    assert bound.main(own) == 0
    assert "1 episode, median 1 s" in capsys.readouterr().out
    assert read(REACH, "state").seeds.tolist() == [1]
    theirs = stored(REACH, "state", tmp_path / "own")
    assert theirs is not None
    assert theirs.seeds.tolist() == [2]


def test_a_search_that_could_not_be_stored_or_read_does_not_begin(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert bound.main(["--tasks", REACH, "--out", str(tmp_path / "file")]) == 2
    assert "cannot be written to" in capsys.readouterr().err
    folder.mkdir()
    file_of(REACH, "state").write_bytes(b"PK")
    assert bound.main(["--tasks", REACH]) == 2
    assert "cannot be read as stored bounds" in capsys.readouterr().err


@pytest.fixture
def carts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Carts that settle by a push, with a bound of each in the files."""
    push = np.zeros((STEPS, 1))
    push[0], push[8] = 1.0, -1.0  # 0.8 s at 0.1 m/s
    monkeypatch.setattr(bound, "Episode", lambda *given: Cart(0.08))
    for seed, force in ((5, push), (6, 0.0 * push)):
        motion = Cart(0.08).motion(force)
        add(REACH, "state", seed, motion, [bound.reached(Cart(0.08), motion)] * 2)  # type: ignore[arg-type]


def tamper(**changed: Any) -> None:
    with np.load(file_of(REACH, "state")) as data:
        np.savez(file_of(REACH, "state"), **(dict(data) | changed))
    stored.cache_clear()


@pytest.mark.usefixtures("carts")
def test_a_replay_reaches_what_is_stored(capsys: pytest.CaptureFixture[str]) -> None:
    """The second cart never moves: infinite then and now."""
    before, now = bound.replay(REACH, "state", read(REACH, "state"))
    assert now.tolist() == before.tolist()
    assert np.isfinite(now).tolist() == [True, False]
    assert bound.main(["--tasks", REACH, "--replay"]) == 0
    assert "2 of 2" in capsys.readouterr().out


@pytest.mark.usefixtures("carts")
@pytest.mark.parametrize("episode", [0, 1])
def test_a_replay_finds_a_changed_bound(episode: int, capsys: pytest.CaptureFixture[str]) -> None:
    best = read(REACH, "state").best.copy()
    best[episode] = 0.5
    tamper(best=best)
    assert bound.main(["--tasks", REACH, "--replay"]) == 1
    assert "1 of 2" in capsys.readouterr().out


@pytest.mark.usefixtures("carts")
@pytest.mark.parametrize("order", [[0, 0], [1, 1]])
def test_a_replay_finds_changed_actions(
    order: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    """The first that settle no more; the second that settle where nothing was reached."""
    tamper(actions=read(REACH, "state").actions[order])
    assert bound.main(["--tasks", REACH, "--replay"]) == 1
    assert "1 of 2" in capsys.readouterr().out


def test_a_replay_of_nothing_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert bound.main(["--tasks", REACH, "--replay"]) == 0
    assert f"{REACH}, state: no bounds are stored" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"seeds": np.arange(3)}, "'seeds': 3, 'best': 2, 'starts': 2"),
        ({"best": np.array([0.5])}, "'best': 1"),
        ({"actions": np.zeros((1, STEPS, 1))}, "'actions': 1"),
        ({"starts": np.zeros((3, 2))}, "'starts': 3"),
        ({"actions": np.zeros((2, STEPS))}, "actions must be 3, got 2"),
        ({"starts": np.zeros(2)}, "starts must be 2, got 1"),
        ({"best": np.zeros((2, 1))}, "best must be 1, got 2"),
        ({"seeds": np.array(5)}, "seeds must be 1, got 0"),
        ({"best": np.array([0.5, 0.6], dtype=object)}, "allow_pickle=False"),
    ],
)
@pytest.mark.usefixtures("carts")
def test_damaged_bounds_are_refused(changed: dict[str, Any], words: str) -> None:
    """Arrays of unequal lengths or of other dimensions; objects, which could run code."""
    tamper(**changed)
    with pytest.raises(ValueError, match=words) as refused:
        read(REACH, "state")
    assert "OneLink-Reach-v0.state.npz" in str(refused.value)


@pytest.mark.usefixtures("carts")
@pytest.mark.parametrize("missing", ["seeds", "best", "starts", "actions"])
def test_bounds_without_an_array_are_refused(missing: str) -> None:
    path = file_of(REACH, "state")
    with np.load(path) as data:
        np.savez(path, **{name: data[name] for name in data if name != missing})
    stored.cache_clear()
    with pytest.raises(ValueError, match=rf"OneLink-Reach-v0\.state\.npz.*{missing}"):
        read(REACH, "state")


@pytest.mark.usefixtures("carts")
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_bounds_that_were_cut_off_are_refused(share: float) -> None:
    path = file_of(REACH, "state")
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    stored.cache_clear()
    with pytest.raises(ValueError, match=r"OneLink-Reach-v0\.state\.npz"):
        read(REACH, "state")


def test_starts_agree_within_a_twentieth_of_the_best() -> None:
    inf = np.inf
    starts = np.array([[20, 21], [10, 10.5], [2, 2.2], [3, 3], [inf, 4], [inf, inf]])
    found = Bounds(np.arange(6), starts.min(axis=1), starts, np.zeros((6, 2, 1)))
    words = "6 episodes, median {}; starts agree within 5 % in 67%"
    assert bound._summary(REACH, found) == words.format("7 s")
    assert bound._summary(TRACK, found) == words.format("7e+03 mm RMS")
