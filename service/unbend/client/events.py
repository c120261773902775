"""The reading of a job's events over several connections, for both clients."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import httpx

from unbend.client.protocol import Json, checked, unreachable
from unbend.errors import ServiceError
from unbend.results.jobs import ENDED_STATES

_MAX_ABSENCE_SECONDS = 60.0
"""Longest time between two events in which the service may be absent. A restart takes seconds."""

_ABSENT_STATUSES = frozenset({502, 503, 504})
"""Statuses of proxies, and of a service that is starting."""


@dataclass
class EventReader:
    """Reads the events of a job over successive connections (WHATWG HTML, section 9.2.6)."""

    url: httpx.URL
    """Address of the service, for errors."""
    done: bool = False
    pause: float = 1.0
    """Seconds before the next connection, set by the service."""
    _last: str | None = None
    _fields: dict[str, str] = field(default_factory=dict)
    _absent_seconds: float = 0.0
    _has_responded: bool = False

    @property
    def headers(self) -> dict[str, str]:
        """The headers of the next request."""
        headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
        return headers if self._last is None else headers | {"Last-Event-ID": self._last}

    def opened(self, response: httpx.Response) -> bool:
        """Return whether a response has events. Read the body of an error response before this call.

        Raises
        ------
        NotFoundError, ServiceError
            If the error is permanent.
        """
        self._fields = {}
        if response.status_code in _ABSENT_STATUSES:
            return False
        checked(response)
        self._has_responded = True
        self.done = response.status_code == httpx.codes.NO_CONTENT
        return not self.done

    def feed(self, line: str) -> Json | None:
        """Process a line; return the job of the event if the line completes one."""
        if line:
            name, _, value = line.partition(":")
            self._fields[name] = value.removeprefix(" ")
            return None
        fields, self._fields = self._fields, {}
        if fields.get("retry", "").isdecimal():
            self.pause = int(fields["retry"]) / 1000.0
        if "data" not in fields:
            return None
        self._last = fields.get("id", self._last)
        self._absent_seconds = 0.0
        job: Json = json.loads(fields["data"])
        self.done = job["state"] in ENDED_STATES
        return job

    def interrupted(self, error: Exception | None = None) -> float:
        """Return the seconds to wait before reconnecting.

        Raises
        ------
        ServiceError
            If the service never responded, or has been absent for too long.
        """
        self._absent_seconds += self.pause
        if not self._has_responded or self._absent_seconds > _MAX_ABSENCE_SECONDS:
            raise unreachable(self.url, error or ServiceError("the events ended before the job"))
        return self.pause
