"""A worker process: what it returns, raises and tells, and what becomes of it when it dies or is killed."""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.support.server import children, is_running
from unbend.errors import ParameterError, WorkerLostError
from unbend.jobs.limits import limit_process
from unbend.jobs.process import WorkerProcess, send_message

PATIENCE = 60.0
LARGE = 20_000_000


@pytest.fixture(scope="module")
def worker():
    process = WorkerProcess(partial(limit_process, None))
    yield process
    process.end()


def raise_ours(name: str) -> None:
    raise ParameterError(f"{name} is wrong")


def raise_what_does_not_travel() -> None:
    class LocalError(Exception):
        pass

    raise LocalError("of this process alone")


def return_what_does_not_travel() -> threading.Lock:
    return threading.Lock()


def count_aloud(most: int) -> int:
    for number in range(most):
        send_message(number)
    return os.getpid()


def killed_after(seconds: float, worker: WorkerProcess) -> threading.Timer:
    timer = threading.Timer(seconds, worker.kill)
    timer.start()
    return timer


def test_it_returns_raises_and_tells(worker):
    heard: list[int] = []
    pid = worker.run(count_aloud, (5,), heard.append)
    assert heard == [0, 1, 2, 3, 4]
    assert pid != os.getpid()
    assert worker.run(os.getpid, ()) == pid
    with pytest.raises(ParameterError, match="this is wrong") as caught:
        worker.run(raise_ours, ("this",))
    assert "raise_ours" in "".join(caught.value.__notes__)  # where, for the log
    assert str(caught.value) == "this is wrong"
    assert worker.run(np.arange, (LARGE // 8,)).nbytes == LARGE
    assert worker.run(os.getpid, ()) == pid


@pytest.mark.parametrize("function", [raise_what_does_not_travel, return_what_does_not_travel])
def test_what_does_not_travel_is_an_error_and_no_end(worker, function):
    pid = worker.run(os.getpid, ())
    with pytest.raises(TypeError, match="cannot be sent"):
        worker.run(function, ())
    assert worker.run(os.getpid, ()) == pid


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT])
def test_one_that_dies_is_lost_and_another_takes_its_place(worker, number):
    pid = worker.run(os.getpid, ())
    with pytest.raises(WorkerLostError):
        worker.run(signal.raise_signal, (number,))
    assert not is_running(pid)
    assert worker.run(os.getpid, ()) != pid


def test_one_that_dies_with_nothing_to_do_is_nobodys_loss(worker):
    pid = worker.run(os.getpid, ())
    os.kill(pid, signal.SIGKILL)
    assert worker.run(os.getpid, ()) != pid


def test_killing_it_ends_what_it_does_at_once(worker):
    pid = worker.run(os.getpid, ())
    worker.prepare()
    begun = time.monotonic()
    timer = killed_after(0.3, worker)
    with pytest.raises(WorkerLostError):
        worker.run(time.sleep, (PATIENCE,))
    timer.join()
    assert time.monotonic() - begun < PATIENCE / 2
    assert not is_running(pid)


def test_it_may_be_killed_in_the_middle_of_a_result(worker):
    worker.prepare()
    pid, heard = worker.run(os.getpid, ()), []

    def stop_reading(news: int) -> None:
        heard.append(news)
        time.sleep(0.5)  # what comes now does not fit into the pipe
        os.kill(pid, signal.SIGKILL)

    with pytest.raises(WorkerLostError):
        worker.run(tell_and_return, (LARGE,), stop_reading)
    assert heard == [LARGE]
    assert worker.run(os.getpid, ()) != pid


def tell_and_return(size: int) -> np.ndarray:
    send_message(size)
    return np.zeros(size // 8)


def test_a_kill_before_it_begins_is_not_forgotten(worker):
    worker.prepare()
    worker.kill()
    with pytest.raises(WorkerLostError):
        worker.run(os.getpid, ())
    worker.prepare()
    assert worker.run(os.getpid, ())


def wait_for(path: Path) -> int:
    """End when somebody has made a file: so that a test knows what a worker is doing, and it what the test wants."""
    while not path.exists():
        time.sleep(0.01)
    return os.getpid()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_to_end_is_left_to_the_server(worker, tmp_path, number):
    pid = worker.run(os.getpid, ())
    with ThreadPoolExecutor(1) as threads:
        running = threads.submit(worker.run, wait_for, (tmp_path / "go on",))
        os.kill(pid, number)
        (tmp_path / "go on").touch()
        assert running.result(PATIENCE) == pid


def starting(worker: WorkerProcess, threads: ThreadPoolExecutor) -> tuple[Future[int], int]:
    """A worker that was given a first function, and the process that starts for it."""
    before = set(children(os.getpid()))
    running = threads.submit(worker.run, os.getpid, ())
    end = time.monotonic() + PATIENCE
    while not (found := set(children(os.getpid())) - before):
        assert time.monotonic() < end
    return running, found.pop()


@pytest.fixture
def threads():
    with ThreadPoolExecutor(1) as executor:
        yield executor


def test_a_signal_to_end_is_left_to_the_server_while_a_worker_starts(threads):
    process = WorkerProcess(partial(limit_process, None))
    try:
        running, pid = starting(process, threads)
        while not running.done():
            os.kill(pid, signal.SIGTERM)
            time.sleep(0.01)
        assert running.result(PATIENCE) == pid
    finally:
        process.end()


def test_one_that_stands_still_with_nothing_to_do_is_replaced():
    process = WorkerProcess(partial(limit_process, None), answer_seconds=0.5)
    try:
        pid = process.run(os.getpid, ())
        os.kill(pid, signal.SIGSTOP)
        assert process.run(os.getpid, ()) != pid
        assert not is_running(pid)
    finally:
        process.end()


def test_one_that_stands_still_while_it_starts_is_replaced(threads):
    process = WorkerProcess(partial(limit_process, None), silent_seconds=8.0)
    try:
        running, pid = starting(process, threads)
        os.kill(pid, signal.SIGSTOP)
        assert running.result(PATIENCE) != pid
        assert not is_running(pid)
    finally:
        process.end()


def test_one_that_takes_long_to_start_is_not_replaced(threads):
    process = WorkerProcess(partial(time.sleep, 10.0), silent_seconds=8.0)
    try:
        running, pid = starting(process, threads)
        assert running.result(PATIENCE) == pid
    finally:
        process.end()
