"""Runs the command line in tests, as a process or within this process, and checks the result."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import traceback
from collections.abc import Sequence
from typing import Any

from click.testing import CliRunner

from tests.support.server import without_settings


def unbend(*arguments: object, **settings: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "unbend", *map(str, arguments)],
        capture_output=True, text=True, timeout=240, check=False, env=without_settings(**settings),
    )  # fmt: skip


def in_process(*arguments: object, **settings: str) -> subprocess.CompletedProcess[str]:
    """Run a command within this process, which saves the seconds that a new process needs for imports."""
    from unbend.cli import main

    ours = {name: None for name in os.environ if name.startswith("UNBEND_")}
    done = CliRunner(env=ours | settings).invoke(main, list(map(str, arguments)))
    if done.exc_info and not isinstance(done.exception, SystemExit | None):
        traceback.print_exception(*done.exc_info)
        return subprocess.CompletedProcess(arguments, 1, done.stdout, f"Traceback: {done.exception!r}")
    return subprocess.CompletedProcess(arguments, done.exit_code, done.stdout, done.stderr)


def on_terminal(command: Sequence[object], stream: str, **others: Any) -> tuple[int, str]:
    """Run a process whose standard output or error is a terminal; return its exit status and what it showed there."""
    ours, theirs = pty.openpty()
    environment = without_settings(TERM="xterm")
    with subprocess.Popen(list(map(str, command)), env=environment, **{stream: theirs}, **others) as process:
        os.close(theirs)
        shown = b""
        while piece := _read(ours):  # a full terminal would block the process
            shown += piece
    os.close(ours)
    return process.returncode, shown.decode()


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 100_000)
    except OSError:  # Linux: the other end is closed
        return b""


def succeeded(*arguments: object, run=unbend, **settings: str) -> subprocess.CompletedProcess[str]:
    done = run(*arguments, **settings)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "\r" not in done.stderr  # no progress bar where there is no terminal
    return done


def failed_with_a_sentence(done: subprocess.CompletedProcess[str], *words: str, status: int = 1) -> None:
    assert done.returncode == status, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    first = done.stderr.splitlines()[0] if status == 1 else done.stderr
    for word in words:
        assert word in first, done.stderr
    if status == 1:
        assert first.startswith("unbend: ")
        assert len(done.stderr.splitlines()) <= 2  # the sentence and the advice
