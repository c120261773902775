"""When a client repeats a request, for both clients."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Final

import httpx

RETRY_SECONDS: Final = 600.0
"""How long a request is repeated by default while the service is at a limit."""

_FAILURES: Final = 4
"""How often a request is repeated after a broken connection, or the error of a proxy."""

_FIRST_PAUSE: Final = 0.25
"""Seconds before the first repetition after a failure; each further pause is twice as long."""

_SAFE: Final = frozenset({"GET", "HEAD", "PUT", "PATCH", "DELETE"})
"""Methods whose repetition changes nothing, because a change sets values instead of adding something."""

_ABSENT: Final = frozenset({502, 503, 504})
"""Statuses of proxies, and of a service that is starting."""


@dataclass
class Attempts:
    """The attempts at one request.

    A request is repeated if the service is at a limit, because it has then done nothing; or if it did not get an
    answer, and repeating it is safe: it never arrived, its method sets values, or it has an idempotency key. Pauses
    are random, so that clients do not return together.
    """

    repeatable: bool
    """Whether the request may arrive twice."""
    seconds: float = RETRY_SECONDS
    """Longest sum of pauses."""
    may_have_arrived: bool = False
    """Whether an earlier attempt may have done its work, although no answer of the service came back."""
    _failures: int = 0
    _waited: float = 0.0

    @classmethod
    def of(cls, method: str, headers: httpx.Headers, seconds: float) -> Attempts:
        """Return the attempts at a request."""
        return cls(method.upper() in _SAFE or "Idempotency-Key" in headers, seconds)

    def pause_after(self, response: httpx.Response) -> float | None:
        """Return the seconds before the next attempt; None if the response is final."""
        wait = response.headers.get("Retry-After", "")
        if response.status_code == httpx.codes.TOO_MANY_REQUESTS or (wait and response.status_code in _ABSENT):
            return self._pause(float(wait) if wait.isdecimal() else 1.0)
        if response.status_code not in _ABSENT or not self.repeatable:
            return None
        self.may_have_arrived = True
        return self._backoff()

    def pause_after_error(self, error: httpx.TransportError) -> float | None:
        """Return the seconds before the next attempt after a broken connection; None if there must be none."""
        arrived = not isinstance(error, httpx.ConnectError | httpx.ConnectTimeout | httpx.PoolTimeout)
        if isinstance(error, httpx.UnsupportedProtocol | httpx.LocalProtocolError) or (arrived and not self.repeatable):
            return None
        self.may_have_arrived |= arrived
        return self._backoff()

    def _backoff(self) -> float | None:
        self._failures += 1
        return self._pause(_FIRST_PAUSE * 2.0 ** (self._failures - 1)) if self._failures <= _FAILURES else None

    def _pause(self, seconds: float) -> float | None:
        pause = seconds * random.uniform(1.0, 1.5)  # noqa: S311  no secret
        self._waited += pause
        return pause if self._waited <= self.seconds else None
