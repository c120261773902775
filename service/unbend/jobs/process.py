"""A worker process that runs one function at a time, and can be killed at any moment without harm to other workers.

Workers share no pipe and no lock. In pools that share them, a process that is killed while it has a lock, or in the
middle of a message, blocks all other workers for ever (docs/decisions.md).

A fork server imports the modules of workers and loads their kernels once (`unbend.jobs.preload`), and each worker is a
fork of it. So a worker starts in milliseconds, and all workers share this memory.
"""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import os
import signal
import threading
import traceback
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess, SpawnProcess
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from typing import Any, Final, TypeVar

from unbend.errors import WorkerLostError

T = TypeVar("T")

Listener = Callable[[Any], None]

_HAS_FORK_SERVER: Final = "forkserver" in multiprocessing.get_all_start_methods()
_PRELOAD: Final = "unbend.jobs.preload"
_START_LOCK: Final = threading.Lock()
"""Held while a process starts, because multiprocessing's tables of child processes are not thread-safe."""

_END_SECONDS: Final = 10.0

_FORK_SECONDS: Final = 300.0
"""A fork server that does not start a worker within this time is replaced. Its own start takes seconds."""

_STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that a worker ignores. The server ends its workers itself, once their jobs are done."""


_ATTEMPTS: Final = 3
_HEARTBEAT_SECONDS: Final = 1.0


@dataclass(frozen=True)
class _Starting:
    pass


@dataclass(frozen=True)
class _Accepted:
    pass


@dataclass(frozen=True)
class _Done:
    result: Any


@dataclass(frozen=True)
class _Raised:
    error: BaseException


@dataclass(frozen=True)
class _Message:
    content: Any


@dataclass(frozen=True)
class _Child:
    """A process, and the parent's end of its pipe."""

    process: BaseProcess
    pipe: Connection

    def kill(self) -> None:
        """Kill the process if it still runs."""
        # The fork server has released the id of a process that ended, so another process may have it now.
        if self.process.is_alive():
            self.process.kill()

    def discard(self) -> None:
        """Kill the process if it still runs, and release its resources."""
        self.pipe.close()
        self.kill()
        self.process.join(_END_SECONDS)


class WorkerProcess:
    """A process that starts when it is first needed, and is replaced when it dies.

    Only one thread may call `run` at a time; any thread may call `kill`.

    Parameters
    ----------
    initialise : callable
        Called in the process before anything else.
    silent_seconds : float, default 60
        A starting process sends a heartbeat every second. It is replaced after this time without a heartbeat.
    answer_seconds : float, default 10
        A ready process that does not accept a function within this time is replaced.
    """

    def __init__(
        self, initialise: Callable[[], None], *, silent_seconds: float = 60.0, answer_seconds: float = 10.0
    ) -> None:
        self._initialise = initialise
        self._silent_seconds = silent_seconds
        self._answer_seconds = answer_seconds
        self._guard = threading.Lock()
        self._child: _Child | None = None
        self._is_ready = False
        self._killed = self._ended = False
        _ALL.add(self)

    def prepare(self) -> None:
        """Cancel the effect of an earlier `kill` on the next `run`."""
        self._killed = False

    def run(
        self,
        function: Callable[..., T],
        arguments: tuple[object, ...],
        listener: Listener | None = None,
        accepted: Callable[[], None] | None = None,
    ) -> T:
        """Run a function in the process.

        Parameters
        ----------
        function, arguments
            Pickled, as is the result.
        listener : callable, optional
            Called with each message that the function sends.
        accepted : callable, optional
            Called when the process has accepted the function.

        Raises
        ------
        WorkerLostError
            If the process died, was killed, or could not be started.
        Exception
            Whatever the function raises.
        """
        child = self._start_function(function, arguments)
        if accepted:
            accepted()
        try:
            while isinstance(message := child.pipe.recv(), _Message):
                if listener:
                    listener(message.content)
        except Exception as error:  # the pipe closed, perhaps within a message
            self._replace(child)
            raise WorkerLostError("the process that ran the job died") from error
        if isinstance(message, _Raised):
            raise message.error
        result: T = message.result
        return result

    def kill(self) -> None:
        """Make the present or next `run` raise, and kill the process unless it is still starting."""
        with self._guard:
            self._killed = True
            if self._child and self._is_ready:
                self._child.kill()

    def end(self) -> None:
        """Kill the process, and start no other."""
        with self._guard:
            self._killed = self._ended = True
            if self._child:
                self._child.kill()
        if self._child:
            self._child.process.join(_END_SECONDS)

    def _start_function(self, function: Callable[..., T], arguments: tuple[object, ...]) -> _Child:
        """Return a process that has accepted the function."""
        for _ in range(_ATTEMPTS):  # replacing a process that died or hung while idle is not an attempt at the job
            try:
                child = self._child if self._child and self._child.process.is_alive() else self._start_process()
            except (EOFError, OSError):
                continue  # the fork server died: the next attempt starts another
            try:
                self._await_ready(child)
                if not self._killed:
                    self._send_function(child, function, arguments)
                    return child
            except (EOFError, OSError):
                self._replace(child)
            if self._killed:
                break
        raise WorkerLostError("no process could be started for the job")

    def _await_ready(self, child: _Child) -> None:
        while not self._is_ready:
            if not child.pipe.poll(self._silent_seconds):
                raise EOFError
            self._is_ready = child.pipe.recv() is None

    def _send_function(self, child: _Child, function: Callable[..., T], arguments: tuple[object, ...]) -> None:
        """Send a function, and wait until the process accepts it: from then on, its death is a failed attempt."""
        with _alarm(self._answer_seconds, child.kill):
            child.pipe.send((function, arguments))
            child.pipe.recv()

    def _start_process(self) -> _Child:
        ours, theirs = multiprocessing.Pipe()
        with _START_LOCK, self._guard:
            if self._ended:
                raise WorkerLostError("the pool was stopped")
            # This process has threads, so it must not be forked itself.
            kind = ForkServerProcess if start_fork_server() else SpawnProcess
            process = kind(target=_serve, args=(theirs, self._initialise), daemon=True)
            with _signals_blocked(), _alarm(_FORK_SECONDS, _kill_fork_server):
                process.start()
            self._child, self._is_ready = _Child(process, ours), False
        theirs.close()  # the pipe then closes when the process ends
        return self._child

    def _replace(self, child: _Child) -> None:
        child.discard()
        if not self._ended:
            with contextlib.suppress(EOFError, OSError):  # the next `run` tries again
                self._start_process()  # at once, so that it is ready before the next job


def start_fork_server() -> bool:
    """Start the fork server of this process's workers, unless it runs; return False if the system has none.

    The first worker does so too. A program that calls this first imports its own modules while the fork server loads.
    """
    if not _HAS_FORK_SERVER:
        return False
    multiprocessing.set_forkserver_preload([_PRELOAD])
    try:
        resource_tracker.ensure_running()  # before, because it unblocks signals
        with _signals_blocked():  # for the whole life of the fork server, which ends with this process
            forkserver.ensure_running()
    except OSError:  # the folder of temporary files has a name too long for a socket, or cannot be written
        return False
    return True


def _kill_fork_server() -> None:
    """Kill the fork server if it does not answer; the next worker starts another."""
    pid = getattr(forkserver._forkserver, "_forkserver_pid", None)  # noqa: SLF001  there is no public name
    if pid is not None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@contextmanager
def _alarm(seconds: float, act: Callable[[], None]) -> Iterator[None]:
    """Call `act`, in a thread, if the block takes longer than `seconds`."""
    timer = threading.Timer(seconds, act)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


_ALL: Final[weakref.WeakSet[WorkerProcess]] = weakref.WeakSet()


@atexit.register
def _end_all() -> None:
    """Kill the remaining workers. multiprocessing would send SIGTERM, which workers ignore, and wait for them."""
    for worker in list(_ALL):
        worker.end()


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Block `_STOP_SIGNALS` in this thread, and in processes that it starts meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOP_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_PIPE: Connection | None = None


def send_message(content: object) -> None:
    """Send a message to the listener of the function that runs in this process; do nothing outside workers."""
    if _PIPE is not None:
        _PIPE.send(_Message(content))


def _serve(pipe: Connection, initialise: Callable[[], None]) -> None:
    """Run the functions that arrive through the pipe, until the pipe closes."""
    global _PIPE  # noqa: PLW0603
    # A terminal sends these signals to the whole process group, so workers receive them too.
    for number in _STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOP_SIGNALS)
    watch = _Watch(pipe)
    initialise()
    watch.report_ready()
    _PIPE = pipe
    while True:
        try:
            function, arguments = pipe.recv()
        except EOFError:
            return
        pipe.send(_Accepted())
        _send(pipe, _outcome(function, arguments))


class _Watch:
    """A thread of a worker that sends heartbeats until the worker is ready, and exits the process when its parent ends.

    Loading kernels takes seconds, compiling them minutes. Without a parent, nobody receives the result.
    """

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._starter = os.getppid()
        self._lock = threading.Lock()
        self._is_ready = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()

    def report_ready(self) -> None:
        with self._lock:
            self._is_ready.set()
            self._pipe.send(None)

    def _run(self) -> None:
        while not self._is_ready.wait(_HEARTBEAT_SECONDS):
            with self._lock, contextlib.suppress(OSError):  # the parent has ended, and the pipe is closed
                if not self._is_ready.is_set():
                    self._pipe.send(_Starting())
        parent = multiprocessing.parent_process()
        if parent is None:
            return
        # Without the fork server, the parent no longer sees whether this process runs.
        while parent.is_alive() and os.getppid() == self._starter:
            parent.join(_HEARTBEAT_SECONDS)
        os._exit(1)


def _outcome(function: Callable[..., Any], arguments: tuple[object, ...]) -> _Done | _Raised:
    try:
        return _Done(function(*arguments))
    except Exception as error:  # noqa: BLE001  the parent raises it
        # Tracebacks cannot be pickled. As a note, the traceback is logged with the error.
        error.add_note("".join(traceback.format_exception(error)))
        return _Raised(error)


def _send(pipe: Connection, outcome: _Done | _Raised) -> None:
    """Send the outcome of a function, or an error if it cannot be pickled."""
    try:
        data = ForkingPickler.dumps(outcome)
        if isinstance(outcome, _Raised):
            # Some exceptions pickle but do not unpickle, because their constructors take other arguments.
            ForkingPickler.loads(data)
    except Exception as error:  # noqa: BLE001  the parent waits for an outcome in any case
        what = outcome.error if isinstance(outcome, _Raised) else outcome.result
        data = ForkingPickler.dumps(_Raised(TypeError(f"{type(what).__name__} cannot be sent: {error}: {what!r:.500}")))
    pipe.send_bytes(data)
