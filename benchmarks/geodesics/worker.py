"""Runs one method in its own process, so that a crash or hang affects no other, and its memory can be measured.

Run as a script, this module is the child: it creates the method named in its arguments and answers calls over a pipe.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NoReturn, Self

from benchmarks.common import ROOT
from benchmarks.geodesics.peers import METHODS
from benchmarks.geodesics.session import Session

_START_SECONDS = 120.0  # the first start after a change compiles kernels


class PeerFailedError(Exception):
    """A method crashed, hung or raised an exception; the message is short enough for a table cell."""


class Worker:
    """The parent's side: starts a process that imports the method and runs it on a small mesh."""

    def __init__(self, name: str, small_mesh: Path) -> None:
        self._arguments = [sys.executable, "-m", "benchmarks.geodesics.worker", name, str(small_mesh)]
        self._start()

    def _start(self) -> None:
        self._connection, there = Pipe()
        self._process = subprocess.Popen(
            [*self._arguments, str(there.fileno())],
            pass_fds=[there.fileno()],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,  # some libraries print their progress
            stderr=subprocess.DEVNULL,
        )
        there.close()
        self._ready = False
        self._dead = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()
        self._process.kill()
        self._process.wait()

    def wait_until_ready(self) -> None:
        """Wait until the method is imported and has run once, or raise PeerFailedError."""
        if self._dead:
            raise PeerFailedError(self._dead)
        if self._ready:
            return
        try:
            self._receive(_START_SECONDS)
            self._ready = True
        except PeerFailedError as failure:
            self._give_up(str(failure))

    def call(self, command: str, *arguments: object, limit: float = 120.0) -> Any:
        """Call the function `command` of the session and return its result, or raise PeerFailedError.

        After a crash, or more than `limit` seconds without an answer, every further call raises, until "open"
        starts a new process.
        """
        if self._dead and command == "open":
            self._start()
        self.wait_until_ready()
        try:
            self._connection.send((command, arguments))
        except OSError:
            self._give_up(_cause_of_death(self._process.wait()))
        return self._receive(limit)

    def _receive(self, limit: float) -> Any:
        if not self._connection.poll(limit):
            self._process.kill()
            self._process.wait()
            self._give_up(f"> {limit:.0f} s")
        try:
            good, value = self._connection.recv()
        except (EOFError, OSError):
            self._give_up(_cause_of_death(self._process.wait()))
        if not good:
            raise PeerFailedError(value)
        return value

    def _give_up(self, reason: str) -> NoReturn:
        self._connection.close()
        self._dead = reason
        raise PeerFailedError(reason)


def _cause_of_death(code: int) -> str:
    return f"crash ({signal.Signals(-code).name})" if code < 0 else f"ended ({code})"


def main(name: str, small_mesh: str, file_number: str) -> None:
    connection = Connection(int(file_number))
    session = _answer(connection, lambda: Session(METHODS[name](), small_mesh), lambda _: None)
    while session:
        try:
            command, arguments = connection.recv()
        except EOFError:
            return
        _answer(connection, lambda: getattr(session, command)(*arguments))  # noqa: B023 - called at once


def _answer(
    connection: Connection, work: Callable[[], Any], reply: Callable[[Any], object] = lambda value: value
) -> Any:
    try:
        value = work()
    except Exception as error:  # noqa: BLE001 - any exception of a library is its result
        connection.send((False, f"{type(error).__name__}: {error}".splitlines()[0][:60]))
        return None
    connection.send((True, reply(value)))
    return value


if __name__ == "__main__":
    main(*sys.argv[1:])
