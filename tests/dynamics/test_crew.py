"""Threads share jobs, survive errors, and go with their crew."""

import gc
import os
import threading
import time

import pytest

from dynamics.crew import Crew


@pytest.mark.parametrize("size", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 3, 200])
def test_every_job_is_done_once(size: int, count: int) -> None:
    crew = Crew(size)
    for _ in range(3):
        done = crew.run(lambda thread, job: (thread, job), range(count))
        assert sorted(job for _, job in done) == list(range(count))
        assert all(0 <= thread < size for thread, _ in done)


def test_a_thread_that_is_held_up_leaves_its_jobs_to_the_others() -> None:
    held, late = threading.Event(), []

    def work(thread: int, job: int) -> int:
        if thread == 1:
            late.append(job)
            assert held.wait(10.0)
        elif job == 9:
            held.set()
        time.sleep(0.01)
        return thread

    done = Crew(2).run(work, range(10))
    assert len(late) == done.count(1) <= 1


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
