"""What both clients share of following a job: reading events, and deciding when to come back for more."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import httpx

from unbend.client.protocol import FINISHED, Json, checked, unreachable
from unbend.errors import ServiceError

_AWAY_SECONDS = 60.0
"""How long a service may be away, between two events, before that is an error: a restart takes some seconds."""

_AWAY_STATUS = frozenset({502, 503, 504})
"""Of proxies, and of a service that is starting."""


@dataclass
class EventReader:
    """Reads a job's events over one connection after another (WHATWG HTML, section 9.2.6)."""

    done: bool = False
    pause: float = 1.0
    """Seconds before the next connection, as the service has it."""
    _last: str | None = None
    _fields: dict[str, str] = field(default_factory=dict)
    _away: float = 0.0
    _met: bool = False

    @property
    def headers(self) -> dict[str, str]:
        """What a connection is asked for with."""
        headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
        return headers if self._last is None else headers | {"Last-Event-ID": self._last}

    def opened(self, response: httpx.Response) -> bool:
        """Return whether a response, read whole unless it is good, has events to read.

        Raises
        ------
        NotFoundError, ServiceError
            Where it is an error that will not pass.
        """
        self._fields = {}
        if response.status_code in _AWAY_STATUS:
            return False
        checked(response)
        self._met = True
        self.done = response.status_code == httpx.codes.NO_CONTENT
        return not self.done

    def feed(self, line: str) -> Json | None:
        """Take a line; return the job that an event has when the line ends one."""
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
        self._away = 0.0
        job: Json = json.loads(fields["data"])
        self.done = job["state"] in FINISHED
        return job

    def interrupted(self, error: Exception | None = None) -> float:
        """Return the seconds to wait before another connection.

        Raises
        ------
        ServiceError
            If the service was never there, or has been away for too long.
        """
        self._away += self.pause
        if not self._met or self._away > _AWAY_SECONDS:
            raise unreachable(error or ServiceError("it ends the events before the job does"))
        return self.pause
