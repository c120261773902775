"""One worker process: it runs one function at a time, and can be ended at any moment without harm to others.

It shares no pipe and no lock with another. Where processes do, one that is killed while it holds a lock, or in the
middle of a message, leaves the others waiting for ever (docs/decisions.md).
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
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from multiprocessing.reduction import ForkingPickler
from typing import Any, Final, TypeVar

from unbend.errors import WorkerLostError

T = TypeVar("T")

Listener = Callable[[Any], None]

_CONTEXT: Final = multiprocessing.get_context("spawn")  # the server has threads, so it must not be forked
_STARTING: Final = threading.Lock()
"""Processes are started one by one: what multiprocessing keeps of its children is not made for several threads."""

_END_SECONDS: Final = 10.0

_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals to end that a worker leaves to the server."""


_TRIES: Final = 3
_SIGN_SECONDS: Final = 1.0


@dataclass(frozen=True)
class _Starting:
    pass


@dataclass(frozen=True)
class _Begun:
    pass


@dataclass(frozen=True)
class _Done:
    result: Any


@dataclass(frozen=True)
class _Raised:
    error: BaseException


@dataclass(frozen=True)
class _Told:
    news: Any


@dataclass(frozen=True)
class _Child:
    """A process and our end of its pipe."""

    process: SpawnProcess
    pipe: Connection

    def bury(self) -> None:
        """Clear away what has ended, or is no use any more."""
        self.pipe.close()
        self.process.kill()
        self.process.join(_END_SECONDS)


class WorkerProcess:
    """A process, started when first needed, and another in its place when it has died.

    `run` is for one thread at a time; `kill` may be called from any.

    Parameters
    ----------
    initialise : callable
        Called in the process before anything else.
    silent_seconds : float, default 60
        A process that starts gives a sign each second. One that gives none for so long is replaced.
    answer_seconds : float, default 10
        A process that does not take a function in this time is replaced.
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
        """Forget an earlier `kill`: what follows is about the next `run`."""
        self._killed = False

    def run(
        self,
        function: Callable[..., T],
        arguments: tuple[object, ...],
        listener: Listener | None = None,
        begun: Callable[[], None] | None = None,
    ) -> T:
        """Run a function in the process.

        Parameters
        ----------
        function, arguments
            They travel to the process, and the result back.
        listener : callable, optional
            Called with what the function tells meanwhile.
        begun : callable, optional
            Called when the process is there and has begun.

        Raises
        ------
        WorkerLostError
            If the process died, was killed, or could not be started.
        Exception
            Whatever the function raises.
        """
        child = self._given(function, arguments)
        if begun:
            begun()
        try:
            while isinstance(message := child.pipe.recv(), _Told):
                if listener:
                    listener(message.news)
        except Exception as error:  # the pipe has ended, perhaps within a message
            self._replace(child)
            raise WorkerLostError("the process that ran the job died") from error
        if isinstance(message, _Raised):
            raise message.error
        result: T = message.result
        return result

    def kill(self) -> None:
        """Have the `run` that is under way, or about to begin, raise; a process that has its function is ended."""
        with self._guard:
            self._killed = True
            if self._child and self._is_ready:
                self._child.process.kill()

    def end(self) -> None:
        """End the process for good."""
        with self._guard:
            self._killed = self._ended = True
            if self._child:
                self._child.process.kill()
        if self._child:
            self._child.process.join(_END_SECONDS)

    def _given(self, function: Callable[..., T], arguments: tuple[object, ...]) -> _Child:
        """Return a process that has been given the function."""
        for _ in range(_TRIES):  # one that died, or stood still, while it had nothing to do is nobody's loss
            child = self._child if self._child and self._child.process.is_alive() else self._begin()
            try:
                self._await_ready(child)
                if not self._killed:
                    self._hand_over(child, function, arguments)
                    return child
            except (EOFError, OSError):
                self._replace(child)
            if self._killed:
                break
        raise WorkerLostError("no process could be had for the job")

    def _await_ready(self, child: _Child) -> None:
        while not self._is_ready:
            if not child.pipe.poll(self._silent_seconds):
                raise EOFError
            self._is_ready = child.pipe.recv() is None

    def _hand_over(self, child: _Child, function: Callable[..., T], arguments: tuple[object, ...]) -> None:
        """Give a process its function, and wait until it has begun: its fate from then on is the function's."""
        alarm = threading.Timer(self._answer_seconds, child.process.kill)
        alarm.daemon = True
        alarm.start()
        try:
            child.pipe.send((function, arguments))
            child.pipe.recv()
        finally:
            alarm.cancel()

    def _begin(self) -> _Child:
        ours, theirs = _CONTEXT.Pipe()
        with _STARTING, self._guard:
            if self._ended:
                raise WorkerLostError("the pool was stopped")
            process = _CONTEXT.Process(target=_serve, args=(theirs, self._initialise), daemon=True)
            with _held_back():
                process.start()
            self._child, self._is_ready = _Child(process, ours), False
        theirs.close()  # so that its end is the end of the pipe
        return self._child

    def _replace(self, child: _Child) -> None:
        child.bury()
        if not self._ended:
            self._begin()  # at once: it makes itself ready while nobody waits for it


_ALL: Final[weakref.WeakSet[WorkerProcess]] = weakref.WeakSet()


@atexit.register
def _end_all() -> None:
    """End what is left: multiprocessing would ask with SIGTERM, which workers ignore, and wait."""
    for worker in list(_ALL):
        worker.end()


@contextmanager
def _held_back() -> Iterator[None]:
    """Hold signals to end back from this thread, and from a process that is started meanwhile."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_PIPE: Connection | None = None


def tell(news: object) -> None:
    """Tell the listener of the function that runs in this process, if this is a worker."""
    if _PIPE is not None:
        _PIPE.send(_Told(news))


def _serve(pipe: Connection, initialise: Callable[[], None]) -> None:
    """Run what comes through the pipe until it ends."""
    global _PIPE  # noqa: PLW0603
    # They come to the whole process group, or control group. The server ends its workers when their jobs are done.
    for number in _ENDING:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
    watch = _Watch(pipe)
    initialise()
    watch.tell_ready()
    _PIPE = pipe
    while True:
        try:
            function, arguments = pipe.recv()
        except EOFError:
            return
        pipe.send(_Begun())
        _send(pipe, _outcome(function, arguments))


class _Watch:
    """A thread of a worker that gives signs of life until it is ready, and ends it when its parent has ended.

    To load kernels takes seconds, to compile them minutes. However the parent ended, nobody wants the work any more.
    """

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._lock = threading.Lock()
        self._is_ready = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()

    def tell_ready(self) -> None:
        with self._lock:
            self._is_ready.set()
            self._pipe.send(None)

    def _run(self) -> None:
        while not self._is_ready.wait(_SIGN_SECONDS):
            with self._lock, contextlib.suppress(OSError):  # the parent has ended
                if not self._is_ready.is_set():
                    self._pipe.send(_Starting())
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)


def _outcome(function: Callable[..., Any], arguments: tuple[object, ...]) -> _Done | _Raised:
    try:
        return _Done(function(*arguments))
    except Exception as error:  # noqa: BLE001  it is raised in the process that asked
        # Tracebacks do not travel; as a note this one is logged where the error is.
        error.add_note("".join(traceback.format_exception(error)))
        return _Raised(error)


def _send(pipe: Connection, outcome: _Done | _Raised) -> None:
    """Send what came of a function, or else that it cannot be sent."""
    try:
        data = ForkingPickler.dumps(outcome)
        if isinstance(outcome, _Raised):
            ForkingPickler.loads(data)  # an exception may go and not arrive: made of other arguments than it keeps
    except Exception as error:  # noqa: BLE001  whatever stands in the way, somebody waits for an answer
        what = outcome.error if isinstance(outcome, _Raised) else outcome.result
        data = ForkingPickler.dumps(_Raised(TypeError(f"{type(what).__name__} cannot be sent: {error}: {what!r:.500}")))
    pipe.send_bytes(data)
