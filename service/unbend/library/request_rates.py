"""Token buckets of callers, in PostgreSQL, so that the limit on requests holds for all servers together."""

from __future__ import annotations

import math
import time
from typing import Final

from sqlalchemy import Connection, text

from unbend.library.storage.store import Store

_MINUTE: Final = 60.0

# A bucket refills while time passes. Statements read the clock of the database, which all servers share.
_TAKE: Final = text(
    """
    INSERT INTO request_rates AS bucket (caller, tokens, at) VALUES (:caller, :size - 1, clock_timestamp())
    ON CONFLICT (caller) DO UPDATE SET
        tokens = greatest(-1, least(:size, bucket.tokens
            + :size * extract(epoch FROM clock_timestamp() - bucket.at) / :minute) - 1),
        at = clock_timestamp()
    RETURNING tokens
    """
)
_GIVE_BACK: Final = text("UPDATE request_rates SET tokens = tokens + 1 WHERE caller = :caller")
_FORGET: Final = text("DELETE FROM request_rates WHERE at < clock_timestamp() - make_interval(secs => :minute)")


class SharedRateLimit:
    """Buckets of `per_minute` tokens that refill in a minute, in a library in PostgreSQL; thread-safe."""

    def __init__(self, store: Store, per_minute: int) -> None:
        self._store = store
        self._size = per_minute
        self._forgot = time.monotonic()

    def take(self, caller: str) -> int:
        """Take a token and return 0, or return the whole seconds until the next token."""

        def take(connection: Connection) -> float:
            tokens = connection.execute(_TAKE, {"caller": caller, "size": self._size, "minute": _MINUTE}).scalar_one()
            if tokens < 0:
                connection.execute(_GIVE_BACK, {"caller": caller})
            return float(tokens)

        tokens = self._store.change(take)
        if time.monotonic() - self._forgot > _MINUTE:
            self._forgot = time.monotonic()
            self._forget()
        return 0 if tokens >= 0 else math.ceil(-tokens * _MINUTE / self._size)

    def _forget(self) -> None:
        """Delete full buckets, which equal new ones."""
        self._store.change(lambda connection: connection.execute(_FORGET, {"minute": _MINUTE}).close())
