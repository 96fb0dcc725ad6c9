"""Threads share jobs, survive errors, and go with their crew."""

import gc
import os
import threading
import time

import pytest

from dynamics.crew import Crew, shares


@pytest.mark.parametrize("size", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 3, 200])
def test_every_job_is_done_once(size: int, count: int) -> None:
    crew = Crew(size)
    for _ in range(3):
        done = crew.run(lambda thread, job: (thread, job), range(count))
        assert sorted(job for _, job in done) == list(range(count))
        assert all(0 <= thread < size for thread, _ in done)


def test_a_thread_that_is_held_up_leaves_its_jobs_to_the_others() -> None:
    taken: list[list[int]] = [[], []]
    none_left = threading.Event()

    def work(thread: int, job: int) -> None:
        taken[thread].append(job)
        if len(taken[0]) + len(taken[1]) == 10:
            none_left.set()
        if thread == 1:
            assert none_left.wait(10.0)
        else:
            time.sleep(0.001)

    Crew(2).run(work, range(10))
    assert len(taken[1]) <= 1
    assert sorted(taken[0] + taken[1]) == list(range(10))


@pytest.mark.parametrize("count", [1, 15, 16, 17, 100, 1024])
@pytest.mark.parametrize("threads", [1, 2, 3, 64])
def test_shares_are_whole_blocks_and_all_there_is(count: int, threads: int) -> None:
    found = shares(count, 16, threads)
    assert [k for a, b in found for k in range(a, b)] == list(range(count))
    assert all(a % 16 == 0 and a < b for a, b in found)
    assert len(found) == 1 if threads == 1 else len(found) <= 4 * threads


def test_an_error_arrives_and_the_crew_works_on() -> None:
    crew = Crew(2)
    meet = threading.Barrier(2)

    def fail(thread: int, job: int) -> int:
        meet.wait(10.0)
        if thread == job_of_failure:
            raise KeyError(thread)
        return thread

    for job_of_failure in (0, 1):
        with pytest.raises(KeyError, match=str(job_of_failure)):
            crew.run(fail, range(2))
    assert sorted(crew.run(lambda thread, job: job, range(4))) == [0, 1, 2, 3]


def test_threads_start_late_and_end_with_the_crew() -> None:
    before = set(threading.enumerate())
    crew = Crew(3)
    assert set(threading.enumerate()) <= before
    crew.run(lambda thread, job: job, range(9))
    mine = set(threading.enumerate()) - before
    assert len(mine) == 2
    del crew
    gc.collect()
    for thread in mine:
        thread.join(10.0)
        assert not thread.is_alive()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no processes by fork here")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_hires_its_own_threads() -> None:
    crew = Crew(2)
    crew.run(lambda thread, job: job, range(4))
    child = os.fork()
    if child == 0:
        done = crew.run(lambda thread, job: job, range(4))
        os._exit(0 if sorted(done) == [0, 1, 2, 3] else 1)
    assert os.waitpid(child, 0)[1] == 0
