"""What was read of an SQLite file, for as long as nobody has written to it."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Final, TypeVar

from sqlalchemy import Engine

T = TypeVar("T")

_MOST: Final = 4096
_VERSION: Final = "PRAGMA data_version"


class Memory:
    """Answers that are true still: whether anybody has written, also another process, SQLite tells in microseconds.

    Thread-safe. It has a connection of its own that never writes, for what SQLite tells is told of all others.
    """

    def __init__(self, engine: Engine) -> None:
        self._lock = threading.Lock()
        self._connection: Any = engine.raw_connection()
        self._version: int | None = None
        self._answers: OrderedDict[Hashable, Any] = OrderedDict()

    def recall(self, question: Hashable, look: Callable[[], T]) -> T:
        """Return the answer that `look` gave to this question, if it is true still; or ask it."""
        with self._lock:
            # Before looking: what is written meanwhile is new to the next who asks.
            ((version,),) = self._connection.driver_connection.execute(_VERSION)
            if version != self._version:
                self._answers.clear()
                self._version = version
            if question in self._answers:
                self._answers.move_to_end(question)
                found: T = self._answers[question]
                return found
            found = self._answers[question] = look()
            if len(self._answers) > _MOST:
                self._answers.popitem(last=False)
            return found

    def close(self) -> None:
        """Give the connection back."""
        self._connection.close()
