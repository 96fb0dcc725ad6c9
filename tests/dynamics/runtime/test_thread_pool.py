"""Threads share chunks, survive errors, and go with their pool."""

import gc
import os
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from dynamics.runtime import thread_pool as module
from dynamics.runtime.jit import on_disk
from dynamics.runtime.thread_pool import ThreadPool
from dynamics.runtime.work_queue import LINE, SIZE, shares, take_chunk
from tests.paths import ROOT


def jobs(count: int) -> Callable[[int], list[int]]:
    """Work: whoever is there takes the next of these until none is left."""
    todo = iter(range(count))
    return lambda thread: list(todo)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_every_job_is_done_once(size: int) -> None:
    """The other threads are awake, falling asleep or asleep when the next run begins."""
    pool, rng = ThreadPool(size), np.random.default_rng(0)
    for k in range(300):
        count = int(rng.integers(6))
        assert sorted(chain(*pool.run(jobs(count)))) == list(range(count))
        if k % 3 == 0:
            time.sleep(rng.uniform(0.0, 1e-3))


def test_who_has_begun_is_waited_for_however_long_it_takes() -> None:
    begun = threading.Event()
    done = []

    def work(thread: int) -> int:
        if thread == 0:
            assert begun.wait(10.0)
        else:
            begun.set()
            time.sleep(0.02)
            done.append(thread)
        return thread

    assert sorted(ThreadPool(2).run(work)) == [0, 1]
    assert done == [1]


def test_nobody_waits_for_a_thread_that_does_not_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor does it begin later what the others have finished."""
    late: list[threading.Thread] = []
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", lambda thread: late.append(thread))
        pool = ThreadPool(2)
        assert pool.run(jobs(3)) == [[0, 1, 2]]
    came: set[int] = set()

    def work(thread: int) -> None:
        came.add(thread)
        time.sleep(1e-3)

    late[0].start()
    for _ in range(1000):
        pool.run(work)
        if came == {0, 1}:
            return
    raise AssertionError("It does not come for later tasks, either.")


def test_a_withdrawn_task_is_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread has read it, but says so only when it is too late; nor does it repeat itself."""
    events: list[str] = []
    change = threading.Condition()

    def tell(event: str) -> None:
        with change:
            events.append(event)
            change.notify_all()

    def expect(event: str) -> None:
        with change:
            assert change.wait_for(lambda: event in events, 10.0)

    class Slow(module._Worker):
        @property
        def _begun(self) -> int:
            if late:
                tell("withdrawn")
                expect("begun")
            return self.__dict__.get("begun", 0)

        @_begun.setter
        def _begun(self, number: int) -> None:
            if late and number > 0:
                tell("read")
                expect("withdrawn")
            self.__dict__["begun"] = number
            if late and number > 0:
                tell("begun")

    monkeypatch.setattr(module, "_Worker", Slow)
    pool, late = ThreadPool(2), False

    def in_time(thread: int) -> int:
        tell(str(thread))
        expect(str(1 - thread))
        return thread

    assert pool.run(in_time) == [0, 1]
    late = True
    assert pool.run(lambda thread: expect("read") if thread == 0 else tell("wrong")) == [None]
    late = False
    assert events[2:] == ["read", "withdrawn", "begun"]


@njit(nogil=True)
def all_turns(rows, thread, taken, often):  # type: ignore[no-untyped-def]
    """Number of chunks that a thread takes; it writes its number to all their rows."""
    count = 0
    start, stop = take_chunk(rows, thread)
    while start < stop:
        count += 1
        for k in range(start, stop):
            taken[k] = thread
            often[k] += 1
        start, stop = take_chunk(rows, thread)
    return count


@pytest.mark.parametrize("count", [1, 15, 16, 17, 100, 1024])
@pytest.mark.parametrize("threads", [1, 2, 3, 64])
@pytest.mark.parametrize("thread", [0, 1, 63])
def test_turns_are_whole_blocks_and_all_there_is(count: int, threads: int, thread: int) -> None:
    """Also for a thread that is alone with the shares of all."""
    taken, often = np.full(count, -1), np.zeros(count, np.int64)
    number = all_turns(shares(count, 16, threads), thread % threads, taken, often)
    np.testing.assert_array_equal(often, 1)
    blocks = -(-count // 16)
    assert number == 1 if threads == 1 else min(blocks, threads) <= number <= blocks


def test_a_thread_takes_its_own_share_first() -> None:
    """Then what others have left, whole blocks at a time."""
    rows = shares(100, 16, 3)
    order = [take_once(rows, 1) for _ in range(8)]
    assert order == [
        (32, 48), (48, 64), (64, 80), (80, 96), (96, 100), (0, 16), (16, 32), (0, 0),
    ]  # fmt: skip


@njit
def take_once(rows, thread):  # type: ignore[no-untyped-def]
    start, stop = take_chunk(rows, thread)
    return int(start), int(stop)


def test_threads_never_take_the_same_turn() -> None:
    """A million short chunks, by four threads that nothing else keeps apart."""
    count = 1_000_000
    rows, pool = shares(count, 1, 4), ThreadPool(4)
    rows[SIZE::LINE] = 1
    taken, often = np.full(count, -1), np.zeros(count, np.int64)
    numbers = pool.run(lambda thread: all_turns(rows, thread, taken, often))
    assert sum(numbers) == count
    np.testing.assert_array_equal(often, 1)


def test_an_error_arrives_and_the_crew_works_on() -> None:
    pool = ThreadPool(2)
    meet = threading.Barrier(2)

    def fail(thread: int) -> int:
        meet.wait(10.0)
        if thread == failing:
            raise KeyError(thread)
        return thread

    for failing in (0, 1):
        with pytest.raises(KeyError, match=str(failing)):
            pool.run(fail)
    assert sorted(chain(*pool.run(jobs(4)))) == [0, 1, 2, 3]


def test_threads_start_late_and_end_with_the_crew() -> None:
    before = set(threading.enumerate())
    pool = ThreadPool(3)
    assert set(threading.enumerate()) <= before
    pool.run(jobs(9))
    mine = set(threading.enumerate()) - before
    assert len(mine) == 2
    del pool
    gc.collect()
    for thread in mine:
        thread.join(10.0)
        assert not thread.is_alive()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no processes by fork here")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_hires_its_own_threads() -> None:
    pool = ThreadPool(2)
    pool.run(jobs(4))
    child = os.fork()
    if child == 0:
        done = chain(*pool.run(jobs(4)))
        os._exit(0 if sorted(done) == [0, 1, 2, 3] else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_what_threads_call_is_compiled_before_they_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads that import and compile at once can meet half-imported modules."""
    compiled: list[bool] = []
    start = threading.Thread.start

    def watched(thread: threading.Thread) -> None:
        compiled.append(bool(module.post_and_wait.signatures))
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", watched)
    monkeypatch.setattr(module, "post_and_wait", on_disk(nogil=True)(module.post_and_wait.py_func))
    assert sorted(chain(*ThreadPool(2).run(jobs(3)))) == [0, 1, 2]
    assert compiled == [True]


def test_a_thread_that_dies_is_reported_and_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    pool = ThreadPool(2)
    with monkeypatch.context() as patch:
        patch.setattr(module._Worker, "_sleep", lambda worker, number: 1 / 0)
        patch.setattr(module, "SPINS", 0)
        pool.run(jobs(4))
        for _ in range(1000):
            if pool._workers[0].failure:
                break
            time.sleep(1e-3)
    with pytest.warns(RuntimeWarning, match="A worker thread ended .ZeroDivisionError"):
        assert sorted(chain(*pool.run(jobs(4)))) == [0, 1, 2, 3]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert sorted(chain(*pool.run(jobs(4)))) == [0, 1, 2, 3]


def test_a_thread_that_dies_within_a_step_ends_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody knows what it has left undone."""
    pool, begun = ThreadPool(2), threading.Event()
    wait = module.post_and_wait

    def dying(post: np.ndarray, mine: int, number: int, *rest: int) -> bool:
        if mine == module.DONE and number == 1:
            raise OSError("gone")
        return wait(post, mine, number, *rest)

    def work(thread: int) -> None:
        if thread == 0:
            assert begun.wait(10.0)
        begun.set()

    monkeypatch.setattr(module, "compiled_for", lambda *_: None)
    monkeypatch.setattr(module, "post_and_wait", dying)
    with pytest.raises(RuntimeError, match=r"within a step .OSError.'gone'.*reset the batch"):
        pool.run(work)


FRESH = """
import warnings
warnings.simplefilter("error")
import numpy as np
from dynamics import Stepper, compile_arm
from dynamics.runtime import thread_pool
thread_pool.LEAST_WORK = 1e-9
stepper = Stepper(compile_arm("slim"), 256, dt=1e-3, substeps=2, threads=2)
stepper.torque[:] = np.linspace(-1.0, 1.0, 256)[:, None]
for _ in range(20):
    stepper.advance()
print(stepper.threads, len(stepper._pool._workers), stepper.q.sum().hex())
"""


def test_threads_of_fresh_processes_never_fail(tmp_path: Path) -> None:
    """With an empty cache, and then four at once with a warm one: two threads, the same numbers."""
    environment = os.environ | {"FLEXARM_CACHE": str(tmp_path)}
    found = []
    for together in (1, 4, 4):
        started = [
            subprocess.Popen(
                [sys.executable, "-c", FRESH], cwd=ROOT, env=environment, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )
            for _ in range(together)
        ]  # fmt: skip
        found += [process.communicate(timeout=300) for process in started]
    assert found == 9 * [found[0]]
    assert found[0][0].startswith("2 1 ")
    assert found[0][1] == ""
