"""Limits on connections: their number, and the time that clients may take.

uvicorn relies on a proxy to limit how long a client may take to send the head of a request or to read a response, and
to close connections whose clients still send. This server does so itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import sys
import uuid
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from unbend.api.context import REQUEST_ID
from unbend.api.schema.headers import headers_for
from unbend.api.schema.problems import answer, of_status

LINGER_SECONDS: Final = 2.0
"""Time for which a connection stays open if its client still sends, so that the client can read the response."""

RETRY_SECONDS: Final = 5
"""Retry-After of a client that is refused because of too many connections."""

HEAD_BYTES: Final = 2**14
"""Largest head of a request."""

_GRACE_SECONDS: Final = 1.0
"""Time for which an idle connection is not evicted if another connection sends a body."""

_DETAILS: Final = {
    400: "this is not a valid HTTP request",
    408: "the head of the request took too long",
    431: "the head of the request is too large",
    501: "this transfer encoding is not supported",
    503: "the server has too many connections",
}

State = Literal["idle", "sending", "served"]
"""The state of a connection: it waits for the head of a request, receives a body, or waits for the server."""


@dataclass(frozen=True)
class ConnectionLimits:
    """Limits on connections."""

    head_seconds: float = 15.0
    """Time for the head of a request: from the start of the connection or, for later requests, from the first byte."""
    stall_seconds: float = 30.0
    """Longest time in which a client reads nothing of a response."""
    transfer_seconds: float = 900.0
    """Longest time of reading a response."""
    connections: int = 10_000


def connection_class(limits: ConnectionLimits) -> type[Connection]:
    """Return the protocol class for uvicorn's setting `http`."""
    return type("LimitedConnection", (Connection,), {"limits": limits, "queue": EvictionQueue()})


class EvictionQueue:
    """The connections of a server that wait for their clients; chooses which of them to evict."""

    def __init__(self) -> None:
        self._idle: OrderedDict[Connection, float] = OrderedDict()
        self._sending: OrderedDict[Connection, float] = OrderedDict()

    def record(self, connection: Connection, state: State, now: float) -> None:
        """Record the state of a connection."""
        self._idle.pop(connection, None)
        self._sending.pop(connection, None)
        if state != "served":
            (self._idle if state == "idle" else self._sending)[connection] = now

    def record_closing(self, connection: Connection) -> None:
        """Record a connection that is closing: the first to evict."""
        self.record(connection, "idle", -math.inf)
        self._idle.move_to_end(connection, last=False)

    def candidate(self, newcomer: Connection, now: float) -> Connection | None:
        """Return the connection to evict; None if there is none but the newcomer.

        By default this is the longest idle connection. If that has been idle for less than `_GRACE_SECONDS`, a
        connection that sends a body is evicted instead, the oldest first.
        """
        idle, since = next(iter(self._idle.items()), (None, math.inf))
        sending = next(iter(self._sending), None)
        if sending and now - since < _GRACE_SECONDS:
            return sending
        return idle if idle is not newcomer else None


class Connection(H11Protocol):
    """uvicorn's connection, with limits.

    - The connection closes if a head arrives too late, with 408 if part of the head has arrived.
    - The connection closes if the client does not read a response in time.
    - If there are too many connections, each new connection evicts one that waits for its client, so that idle
      connections do not lock out other clients.
    - A client that gets a response before it has sent the whole request has time to read the response. If the server
      closed at once, the system would respond to further bytes with a reset, which can destroy the response.
    - Invalid HTTP gets a problem document.
    """

    limits: ClassVar[ConnectionLimits] = ConnectionLimits()
    queue: ClassVar[EvictionQueue] = EvictionQueue()

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._state: State = "served"
        self._is_closing = False
        self._is_refused = False
        self._client_timer = _Timer(self.loop)
        self._read_timer = _Timer(self.loop)

    # Called by asyncio

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for a head, and evict another connection if there are too many."""
        self._raw = transport
        super().connection_made(_Transport(transport, self._close_gently))
        self._update_state()
        if len(self.connections) > self.limits.connections:
            self._evict_one()

    def data_received(self, data: bytes) -> None:
        """Process received data, unless the connection is closing."""
        if self._is_closing:
            return
        # The parser refuses a longer incomplete head, so feed it at most HEAD_BYTES + 1 bytes at a time.
        taken = HEAD_BYTES + 1 - len(self.conn.trailing_data[0]) if self.conn.their_state is h11.IDLE else len(data)
        super().data_received(data[:taken])
        if len(data) > taken and not self._is_closing:
            super().data_received(data[taken:])
        self._update_state()

    def pause_writing(self) -> None:
        """Make the application wait for the client, for a limited time."""
        super().pause_writing()
        self._watch()

    def resume_writing(self) -> None:
        """Let the application continue."""
        super().resume_writing()
        if not self.transport.is_closing():
            self._read_timer.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection from the queue."""
        super().connection_lost(exc)
        self.queue.record(self, "served", 0.0)
        self._client_timer.cancel()
        self._read_timer.cancel()

    # Called by uvicorn

    def on_response_complete(self) -> None:
        """Wait for the next head; uvicorn's keep-alive limit applies until its first byte."""
        super().on_response_complete()
        self._update_state()

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002  `_DETAILS` has better messages
        """Respond to invalid HTTP. uvicorn calls this for errors of the parser."""
        error = sys.exc_info()[1]
        self._refuse(error.error_status_hint if isinstance(error, h11.RemoteProtocolError) else 400)

    # Waiting for the client

    def _update_state(self) -> None:
        """Record the present state, and limit the time of a partial head."""
        state: State = "served"
        # DONE: the response is complete, but not the request.
        if self.conn.our_state in {h11.IDLE, h11.DONE}:
            state = "idle"
        elif self.conn.their_state is h11.SEND_BODY:
            state = "sending"
        if self._is_closing:
            return
        if state != self._state:
            self._state = state
            self.queue.record(self, state, self.loop.time())
        if state != "idle":
            self._client_timer.cancel()
        elif not (self._client_timer.is_set or self.timeout_keep_alive_task):
            self._client_timer.set(self.limits.head_seconds, self._on_client_timeout)

    def _on_client_timeout(self) -> None:
        if self.conn.our_state is h11.IDLE and self.conn.trailing_data[0]:
            self._refuse(408)
        else:
            self.transport.close()

    def _evict_one(self) -> None:
        longest = self.queue.candidate(self, self.loop.time())
        if longest is None:
            self._refuse(503)
        else:
            longest.evict()

    def evict(self) -> None:
        """Close the connection in favour of another; a client that sends a body gets a 503 response."""
        if self._state == "sending" and not self._is_closing:
            self._refuse(503)
        else:
            self.queue.record(self, "served", 0.0)  # now, because others may arrive before asyncio reports the loss
            self._raw.abort()

    # Closing

    def _refuse(self, status: int) -> None:
        """Respond with a problem to any request, and close."""
        cycle: RequestResponseCycle | None = self.cycle
        if cycle and not cycle.response_complete:  # tell the application that the client has disconnected
            cycle.disconnected = True
            cycle.message_event.set()
        headers = headers_for("") | {REQUEST_ID: uuid.uuid4().hex, "Connection": "close"}
        if status == 503:
            headers["Retry-After"] = str(RETRY_SECONDS)
        problem = of_status(status, _DETAILS.get(status, _DETAILS[400]))
        response = answer(problem, headers)
        sent = (
            h11.Response(status_code=status, headers=response.raw_headers, reason=problem.title.encode()),
            h11.Data(data=bytes(response.body)),
            h11.EndOfMessage(),
        )
        with contextlib.suppress(h11.LocalProtocolError):  # a response has begun already
            self._raw.write(b"".join(self.conn.send(part) or b"" for part in sent))
        self._is_refused = True
        self.transport.close()

    def _close_gently(self) -> None:
        """Close when everything is sent. If the client still sends, shut down writing first, and read for a while."""
        if self._is_closing or self._raw.is_closing():
            self._raw.close()
            return
        self._is_closing = True
        self._client_timer.cancel()
        self.queue.record_closing(self)
        unread = self._is_refused or self.conn.their_state in {h11.SEND_BODY, h11.ERROR}
        if unread and self._raw.can_write_eof():
            with contextlib.suppress(OSError):  # the client has disconnected already
                self._raw.write_eof()
            self._raw.resume_reading()
            self._client_timer.set(LINGER_SECONDS, self._raw.abort)
        else:
            self._raw.close()
        if not self._read_timer.is_set:
            self._watch()

    def _watch(self) -> None:
        """Abort the connection if the client stops reading, or reads for too long."""
        end = self.loop.time() + self.limits.transfer_seconds

        def look(before: int) -> None:
            left = self._raw.get_write_buffer_size()
            if left >= before or self.loop.time() >= end:
                self._raw.abort()
            elif left:
                again(left)
            else:
                self._read_timer.cancel()

        def again(left: int) -> None:
            self._read_timer.set(self.limits.stall_seconds, look, left)

        if left := self._raw.get_write_buffer_size():
            again(left)


class _Transport(asyncio.Transport):
    """uvicorn's transport, with another way of closing."""

    def __init__(self, transport: asyncio.Transport, leave: Callable[[], None]) -> None:
        super().__init__()
        self._transport = transport
        self._leave = leave
        self._closing = False

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return self._transport.get_extra_info(name, default)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self._transport.write(data)

    def pause_reading(self) -> None:
        self._transport.pause_reading()

    def resume_reading(self) -> None:
        self._transport.resume_reading()

    def is_closing(self) -> bool:
        return self._closing or self._transport.is_closing()

    def close(self) -> None:
        self._closing = True
        self._leave()


class _Timer:
    """A timer for one call."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._handle: asyncio.TimerHandle | None = None

    @property
    def is_set(self) -> bool:
        return self._handle is not None

    def set(self, seconds: float, call: Callable[..., None], *arguments: object) -> None:
        self.cancel()
        self._handle = self._loop.call_later(seconds, call, *arguments)

    def cancel(self) -> None:
        if self._handle:
            self._handle.cancel()
            self._handle = None
