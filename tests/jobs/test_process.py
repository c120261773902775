"""A worker process: its results, errors and messages, and its replacement when it dies or is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.support.server import children, is_running, without_settings, workers_of
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


def raise_unpicklable() -> None:
    class LocalError(Exception):
        pass

    raise LocalError("cannot be pickled")


def return_unpicklable() -> threading.Lock:
    return threading.Lock()


def send_numbers(most: int) -> int:
    for number in range(most):
        send_message(number)
    return os.getpid()


def killed_after(seconds: float, worker: WorkerProcess) -> threading.Timer:
    timer = threading.Timer(seconds, worker.kill)
    timer.start()
    return timer


def test_a_worker_returns_results_raises_errors_and_sends_messages(worker):
    heard: list[int] = []
    pid = worker.run(send_numbers, (5,), heard.append)
    assert heard == [0, 1, 2, 3, 4]
    assert pid != os.getpid()
    assert worker.run(os.getpid, ()) == pid
    with pytest.raises(ParameterError, match="this is wrong") as caught:
        worker.run(raise_ours, ("this",))
    assert "raise_ours" in "".join(caught.value.__notes__)  # the traceback of the worker, for the log
    assert str(caught.value) == "this is wrong"
    assert worker.run(np.arange, (LARGE // 8,)).nbytes == LARGE
    assert worker.run(os.getpid, ()) == pid


@pytest.mark.parametrize("function", [raise_unpicklable, return_unpicklable])
def test_a_result_that_cannot_be_pickled_is_an_error_and_the_worker_lives_on(worker, function):
    pid = worker.run(os.getpid, ())
    with pytest.raises(TypeError, match="cannot be sent"):
        worker.run(function, ())
    assert worker.run(os.getpid, ()) == pid


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT])
def test_a_worker_that_dies_raises_an_error_and_is_replaced(worker, number):
    pid = worker.run(os.getpid, ())
    with pytest.raises(WorkerLostError):
        worker.run(signal.raise_signal, (number,))
    assert not is_running(pid)
    assert worker.run(os.getpid, ()) != pid


def printed_by(code: str, folder: Path, **settings: str) -> str:
    """Return what a program prints; it may start workers, because it is a file that they can import."""
    script = folder / "script.py"
    script.write_text(code)
    done = subprocess.run(
        [sys.executable, script], env=without_settings(**settings), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_workers_start_with_the_kernels_that_are_on_disk(tmp_path):
    code = """
from unbend.embedding.stress import raw_stress
from unbend.jobs.process import WorkerProcess
from unbend.jobs.worker import warm_up

def loaded():
    return len(raw_stress.signatures)

if __name__ == "__main__":
    warm_up()
    worker = WorkerProcess(dict)
    print(loaded(), worker.run(loaded, ()))
    worker.end()
"""
    here, there = map(int, printed_by(code, tmp_path).split())
    assert here == there > 0


def test_workers_outlive_no_fork_server(worker):
    first = worker.run(os.getpid, ())
    (fork_server,) = children(os.getpid(), "forkserver")
    with ThreadPoolExecutor(1) as threads:
        began = threading.Event()
        running = threads.submit(worker.run, time.sleep, (PATIENCE,), None, began.set)
        assert began.wait(PATIENCE)
        os.kill(fork_server, signal.SIGKILL)
        with pytest.raises(WorkerLostError):
            running.result(PATIENCE)
    end = time.monotonic() + PATIENCE
    while is_running(first):
        assert time.monotonic() < end
        time.sleep(0.05)
    assert worker.run(os.getpid, ()) != first
    assert children(os.getpid(), "forkserver") != [fork_server]


def test_a_folder_of_temporary_files_that_fits_no_socket_is_no_hindrance(tmp_path):
    folder = tmp_path / ("n" * 120)
    folder.mkdir()
    code = """
import os
from unbend.jobs.process import WorkerProcess

if __name__ == "__main__":
    print(WorkerProcess(dict).run(os.getpid, ()))
"""
    assert printed_by(code, tmp_path, TMPDIR=str(folder)).strip().isdigit()


def test_an_idle_worker_that_dies_is_replaced_without_an_error(worker):
    pid = worker.run(os.getpid, ())
    os.kill(pid, signal.SIGKILL)
    assert worker.run(os.getpid, ()) != pid


def test_killing_a_worker_ends_its_call_at_once(worker):
    pid = worker.run(os.getpid, ())
    worker.prepare()
    begun = time.monotonic()
    timer = killed_after(0.3, worker)
    with pytest.raises(WorkerLostError):
        worker.run(time.sleep, (PATIENCE,))
    timer.join()
    assert time.monotonic() - begun < PATIENCE / 2
    assert not is_running(pid)


def test_a_worker_can_be_killed_while_it_sends_a_result(worker):
    worker.prepare()
    pid, heard = worker.run(os.getpid, ()), []

    def stop_reading(news: int) -> None:
        heard.append(news)
        time.sleep(0.5)  # meanwhile the worker sends a result that does not fit into the pipe
        os.kill(pid, signal.SIGKILL)

    with pytest.raises(WorkerLostError):
        worker.run(tell_and_return, (LARGE,), stop_reading)
    assert heard == [LARGE]
    assert worker.run(os.getpid, ()) != pid


def tell_and_return(size: int) -> np.ndarray:
    send_message(size)
    return np.zeros(size // 8)


def test_a_kill_before_the_call_ends_the_call(worker):
    worker.prepare()
    worker.kill()
    with pytest.raises(WorkerLostError):
        worker.run(os.getpid, ())
    worker.prepare()
    assert worker.run(os.getpid, ())


def wait_for(path: Path) -> int:
    """Wait until the test creates a file, so that the test controls when the call ends."""
    while not path.exists():
        time.sleep(0.01)
    return os.getpid()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_worker_ignores_termination_signals(worker, tmp_path, number):
    pid = worker.run(os.getpid, ())
    with ThreadPoolExecutor(1) as threads:
        running = threads.submit(worker.run, wait_for, (tmp_path / "go on",))
        os.kill(pid, number)
        (tmp_path / "go on").touch()
        assert running.result(PATIENCE) == pid


def starting(worker: WorkerProcess, threads: ThreadPoolExecutor) -> tuple[Future[int], int]:
    """Start a first call; return its future, and the id of the process that starts for it."""
    first = WorkerProcess(dict)
    first.run(os.getpid, ())  # the fork server may have other children while it loads modules
    first.end()
    before = set(workers_of(os.getpid()))
    running = threads.submit(worker.run, os.getpid, ())
    end = time.monotonic() + PATIENCE
    while not (found := set(workers_of(os.getpid())) - before):
        assert time.monotonic() < end
    return running, found.pop()


@pytest.fixture
def threads():
    with ThreadPoolExecutor(1) as executor:
        yield executor


def test_a_starting_worker_ignores_termination_signals(threads):
    process = WorkerProcess(partial(time.sleep, 1.0))
    try:
        running, pid = starting(process, threads)
        while not running.done():
            os.kill(pid, signal.SIGTERM)
            time.sleep(0.01)
        assert running.result(PATIENCE) == pid
    finally:
        process.end()


def test_an_idle_worker_that_is_stopped_is_replaced():
    process = WorkerProcess(partial(limit_process, None), answer_seconds=0.5)
    try:
        pid = process.run(os.getpid, ())
        os.kill(pid, signal.SIGSTOP)
        assert process.run(os.getpid, ()) != pid
        assert not is_running(pid)
    finally:
        process.end()


def test_a_worker_that_is_stopped_while_it_starts_is_replaced(threads):
    process = WorkerProcess(partial(time.sleep, 1.0), silent_seconds=8.0)
    try:
        running, pid = starting(process, threads)
        os.kill(pid, signal.SIGSTOP)
        assert running.result(PATIENCE) != pid
        assert not is_running(pid)
    finally:
        process.end()


def test_a_worker_that_starts_slowly_is_not_replaced(threads):
    process = WorkerProcess(partial(time.sleep, 10.0), silent_seconds=8.0)
    try:
        running, pid = starting(process, threads)
        assert running.result(PATIENCE) == pid
    finally:
        process.end()
