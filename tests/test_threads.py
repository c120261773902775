"""Work on many items in threads."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from unbend import compute_signature, embed
from unbend.mesh.shapes import torus
from unbend.threads import Team, one_blas_thread, share_out


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 100])
def test_every_item_is_worked_on_once_on_any_number_of_threads(count, threads):
    done, shares, lock = [], [], threading.Lock()

    def work(part: slice) -> None:
        with lock:
            done.extend(range(part.start, part.stop))

    share_out(count, threads, work, shares.append)
    assert sorted(done) == list(range(count))
    assert shares[-1:] == ([1.0] if count else [])


def test_an_error_in_any_thread_reaches_the_caller_and_the_team_goes_on():
    def fail(part: slice) -> None:
        if part.start <= 50 < part.stop:
            raise ValueError(part)

    done = []
    with Team(3) as team:
        for _ in range(20):
            with pytest.raises(ValueError, match="slice"):
                team.share_out(100, fail)
        team.share_out(100, done.append)
    assert sum(part.stop - part.start for part in done) == 100


def test_a_task_does_not_wait_for_threads_that_have_not_begun_to_help():
    busy, free = threading.Event(), threading.Event()

    def occupy(_: slice) -> None:
        busy.set()
        free.wait(60)

    done = []
    with Team(2) as team:
        occupied = threading.Thread(target=lambda: team.share_out(2, occupy))
        occupied.start()
        assert busy.wait(60)
        begun = time.monotonic()
        team.share_out(100, done.append)  # the helper may be busy with the other task
        assert time.monotonic() - begun < 30
        free.set()
        occupied.join()
    assert sum(part.stop - part.start for part in done) == 100


def blas_threads() -> set[int]:
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


def test_small_matrices_use_one_thread_of_blas_and_the_callers_setting_returns():
    seen = []
    points = np.random.default_rng(0).normal(size=(100, 3))
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        embed(distances, progress=lambda *_: seen.append(blas_threads()))
        compute_signature(torus(), {"samples": 30}, progress=lambda _: seen.append(blas_threads()))
        assert blas_threads() == before
    assert {1} in seen
    assert all(each == {1} for each in seen)


def test_the_limit_of_blas_ends_with_its_last_user():
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with ExitStack() as first:
            first.enter_context(one_blas_thread(100))
            second = ExitStack()
            second.enter_context(one_blas_thread(100))
        assert blas_threads() == {1}
        second.close()
        assert blas_threads() == before
        with one_blas_thread(10_000):
            assert blas_threads() == before
