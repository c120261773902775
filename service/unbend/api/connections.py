"""What one connection may take of the server, and how many there may be.

uvicorn answers requests. How long a client may take for a request's head, or to read an answer, and what becomes of one
that is answered while it still sends, it leaves to a proxy. Here they are the server's own.
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

from unbend.api.headers import headers_for
from unbend.api.problems import answer, of_status
from unbend.api.requests import HEADER

LINGER_SECONDS: Final = 2.0
"""That a client which is answered while it still sends has to read the answer."""

RETRY_SECONDS: Final = 5
"""After which a client that found too many connections may come again."""

HEAD_BYTES: Final = 2**14
"""That the head of a request may have."""

_GRACE_SECONDS: Final = 1.0  # that a head has before others' bodies, for where all connections send bodies

_DETAILS: Final = {
    400: "this is no request as HTTP has it",
    408: "the head of the request took too long",
    431: "the head of the request is too large",
    501: "this transfer encoding is not supported",
    503: "the server has too many connections",
}

Turn = Literal["idle", "sending", "served"]
"""What a connection waits for: a head (or nothing more), the rest of a body, the server."""


@dataclass(frozen=True)
class ConnectionLimits:
    """What connections may take."""

    head_seconds: float = 15.0
    """For the head of a request, from the connection's beginning or, of a later one, from its first byte."""
    stall_seconds: float = 30.0
    """In which nothing of an answer is taken."""
    transfer_seconds: float = 900.0
    """For taking an answer."""
    connections: int = 10_000


def connection_class(limits: ConnectionLimits) -> type[Connection]:
    """Return the class of a server's connections: uvicorn's setting `http`."""
    return type("LimitedConnection", (Connection,), {"limits": limits, "room": Room()})


class Room:
    """Who may be shown out: the connections of a server that wait for their clients, and since when."""

    def __init__(self) -> None:
        self._idle: OrderedDict[Connection, float] = OrderedDict()
        self._sending: OrderedDict[Connection, float] = OrderedDict()

    def place(self, connection: Connection, turn: Turn, now: float) -> None:
        """Note whose turn it is."""
        self._idle.pop(connection, None)
        self._sending.pop(connection, None)
        if turn != "served":
            (self._idle if turn == "idle" else self._sending)[connection] = now

    def place_first(self, connection: Connection) -> None:
        """Note a connection that is ended already."""
        self.place(connection, "idle", -math.inf)
        self._idle.move_to_end(connection, last=False)

    def longest(self, newcomer: Connection, now: float) -> Connection | None:
        """Return who waits longest for a head, or else for the rest of a body; None if there is only the newcomer."""
        idle, since = next(iter(self._idle.items()), (None, math.inf))
        sending = next(iter(self._sending), None)
        if sending and now - since < _GRACE_SECONDS:
            return sending
        return idle if idle is not newcomer else None


class Connection(H11Protocol):
    """uvicorn's connection, with limits.

    - A head that is not there in time ends it, with 408 if some of it is.
    - An answer that is not taken in time ends it.
    - Where there are too many, one that waits for its client is ended for each that comes: idle ones lock nobody out.
    - A client that is answered before it has sent everything is given time to read the answer. Were the connection
      closed at once, what the client still sends would be met by a reset, which can take the answer from it.
    - What is no HTTP is answered with a problem document.
    """

    limits: ClassVar[ConnectionLimits] = ConnectionLimits()
    room: ClassVar[Room] = Room()

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._turn: Turn = "served"
        self._leaving = False
        self._refused = False
        self._patience = _Alarm(self.loop)
        self._taking = _Alarm(self.loop)

    # What asyncio tells

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a head, and end another connection where there are too many."""
        self._raw = transport
        super().connection_made(_Transport(transport, self._leave))
        self._note()
        if len(self.connections) > self.limits.connections:
            self._make_room()

    def data_received(self, data: bytes) -> None:
        """Take what came, unless nothing is wanted any more."""
        if self._leaving:
            return
        # The parser refuses a head that is longer and not yet whole, so it gets no more before it has said so.
        taken = HEAD_BYTES + 1 - len(self.conn.trailing_data[0]) if self.conn.their_state is h11.IDLE else len(data)
        super().data_received(data[:taken])
        if len(data) > taken and not self._leaving:
            super().data_received(data[taken:])
        self._note()

    def pause_writing(self) -> None:
        """Have the application wait for the client, and not for ever."""
        super().pause_writing()
        self._watch()

    def resume_writing(self) -> None:
        """Have the application go on."""
        super().resume_writing()
        if not self.transport.is_closing():
            self._taking.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        super().connection_lost(exc)
        self.room.place(self, "served", 0.0)
        self._patience.cancel()
        self._taking.cancel()

    # What uvicorn calls

    def on_response_complete(self) -> None:
        """Wait for the next head; until its first byte uvicorn's own limit holds."""
        super().on_response_complete()
        self._note()

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002  ours says more
        """Answer what is no HTTP. Called where uvicorn meets the parser's error."""
        error = sys.exc_info()[1]
        self._refuse(error.error_status_hint if isinstance(error, h11.RemoteProtocolError) else 400)

    # Waiting for the client

    def _note(self) -> None:
        """See whose turn it is, and limit the time for a head that is on its way."""
        turn: Turn = "served"
        if self.conn.our_state in {h11.IDLE, h11.DONE}:  # DONE: what is answered is not read to its end
            turn = "idle"
        elif self.conn.their_state is h11.SEND_BODY:
            turn = "sending"
        if self._leaving:
            return
        if turn != self._turn:
            self._turn = turn
            self.room.place(self, turn, self.loop.time())
        if turn != "idle":
            self._patience.cancel()
        elif not (self._patience.is_set or self.timeout_keep_alive_task):
            self._patience.set(self.limits.head_seconds, self._lose_patience)

    def _lose_patience(self) -> None:
        if self.conn.our_state is h11.IDLE and self.conn.trailing_data[0]:
            self._refuse(408)
        else:
            self.transport.close()

    def _make_room(self) -> None:
        longest = self.room.longest(self, self.loop.time())
        if longest is None:
            self._refuse(503)
        else:
            longest.show_out()

    def show_out(self) -> None:
        """End it, so that another can be served; with a word if it is sending a request."""
        if self._turn == "sending" and not self._leaving:
            self._refuse(503)
        else:
            self.room.place(self, "served", 0.0)  # at once, for many may come before asyncio tells that it is lost
            self._raw.abort()

    # Ending it

    def _refuse(self, status: int) -> None:
        """Answer with a problem, whatever was asked, and end it."""
        cycle: RequestResponseCycle | None = self.cycle
        if cycle and not cycle.response_complete:  # for the application the client has gone
            cycle.disconnected = True
            cycle.message_event.set()
        headers = headers_for("") | {HEADER: uuid.uuid4().hex, "Connection": "close"}
        if status == 503:
            headers["Retry-After"] = str(RETRY_SECONDS)
        problem = of_status(status, _DETAILS.get(status, _DETAILS[400]))
        response = answer(problem, headers)
        sent = (
            h11.Response(status_code=status, headers=response.raw_headers, reason=problem.title.encode()),
            h11.Data(data=bytes(response.body)),
            h11.EndOfMessage(),
        )
        with contextlib.suppress(h11.LocalProtocolError):  # an answer has begun already
            self._raw.write(b"".join(self.conn.send(part) or b"" for part in sent))
        self._refused = True
        self.transport.close()

    def _leave(self) -> None:
        """Close it when all is taken; where the client still sends, tell it the end first, and read on for a while."""
        if self._leaving or self._raw.is_closing():
            self._raw.close()
            return
        self._leaving = True
        self._patience.cancel()
        self.room.place_first(self)
        unread = self._refused or self.conn.their_state in {h11.SEND_BODY, h11.ERROR}
        if unread and self._raw.can_write_eof():
            with contextlib.suppress(OSError):  # it has gone already
                self._raw.write_eof()
            self._raw.resume_reading()
            self._patience.set(LINGER_SECONDS, self._raw.abort)
        else:
            self._raw.close()
        if not self._taking.is_set:
            self._watch()

    def _watch(self) -> None:
        """Look from time to time whether the client takes what is written."""
        end = self.loop.time() + self.limits.transfer_seconds

        def look(before: int) -> None:
            left = self._raw.get_write_buffer_size()
            if left >= before or self.loop.time() >= end:
                self._raw.abort()
            elif left:
                again(left)
            else:
                self._taking.cancel()

        def again(left: int) -> None:
            self._taking.set(self.limits.stall_seconds, look, left)

        if left := self._raw.get_write_buffer_size():
            again(left)


class _Transport(asyncio.Transport):
    """A transport as uvicorn uses it, but for what becomes of a connection that is closed."""

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


class _Alarm:
    """One call to come, or none."""

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
