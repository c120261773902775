"""Rate limits by token buckets in memory, one for each caller."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

_MINUTE: Final = 60.0
_MOST_CALLERS: Final = 10_000
"""With this many buckets or more, full ones are evicted. A full bucket equals a new one."""


@dataclass(frozen=True)
class _Bucket:
    tokens: float
    at: float


class RateLimit:
    """Buckets of `per_minute` tokens that refill in a minute; not thread-safe.

    Parameters
    ----------
    per_minute : int
        0 for no limit.
    clock : callable
        Returns monotonic seconds.
    """

    def __init__(self, per_minute: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._size = per_minute
        self._clock = clock
        self._buckets: dict[str, _Bucket] = {}

    def take(self, caller: str) -> int:
        """Take a token and return 0, or return the whole seconds until the next token."""
        if not self._size:
            return 0
        now = self._clock()
        tokens = self._tokens(self._buckets.get(caller), now)
        if tokens < 1:
            return math.ceil((1 - tokens) * _MINUTE / self._size)
        if len(self._buckets) >= _MOST_CALLERS:
            self._buckets = {
                name: bucket for name, bucket in self._buckets.items() if self._tokens(bucket, now) < self._size
            }
        self._buckets[caller] = _Bucket(tokens - 1, now)
        return 0

    def _tokens(self, bucket: _Bucket | None, now: float) -> float:
        if bucket is None:
            return self._size
        return min(self._size, bucket.tokens + (now - bucket.at) * self._size / _MINUTE)
