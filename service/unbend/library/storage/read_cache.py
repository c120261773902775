"""A cache of reads from an SQLite file. Any write to the file, by any process, invalidates the cache."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Final, TypeVar

from sqlalchemy import Engine

T = TypeVar("T")

_MAX_ENTRIES: Final = 4096
_VERSION: Final = "PRAGMA data_version"


class ReadCache:
    """A cache of the most recently used values, which are valid until the file changes. Thread-safe.

    SQLite's `data_version` detects a change within microseconds. It changes only by writes of other connections, so the
    cache has a connection that never writes.
    """

    def __init__(self, engine: Engine) -> None:
        self._lock = threading.Lock()
        self._connection: Any = engine.raw_connection()
        self._version: int | None = None
        self._values: OrderedDict[Hashable, Any] = OrderedDict()

    def get_or_load(self, key: Hashable, load: Callable[[], T]) -> T:
        """Return the cached value of a key if it is still valid; otherwise load the value and cache it."""
        with self._lock:
            # Read the version before loading: a write during the load then invalidates the loaded value.
            ((version,),) = self._connection.driver_connection.execute(_VERSION)
            if version != self._version:
                self._values.clear()
                self._version = version
            if key in self._values:
                self._values.move_to_end(key)
                cached: T = self._values[key]
                return cached
            loaded = self._values[key] = load()
            if len(self._values) > _MAX_ENTRIES:
                self._values.popitem(last=False)
            return loaded

    def close(self) -> None:
        """Return the connection to its pool."""
        self._connection.close()
