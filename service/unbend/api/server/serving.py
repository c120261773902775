"""The server process: sockets, signals and shutdown."""

from __future__ import annotations

import errno
import logging
import signal
import socket
from collections.abc import Sequence
from types import FrameType
from typing import Final

import uvicorn
from fastapi import FastAPI

from unbend.api.server.service import Service
from unbend.errors import AddressError

logger = logging.getLogger("uvicorn.error")

_STOP_SIGNALS: Final = tuple(getattr(signal, name) for name in ("SIGHUP",) if hasattr(signal, name))
"""Other signals that stop a server as SIGTERM does. A terminal that closes sends SIGHUP."""


class Server(uvicorn.Server):
    """uvicorn's server, which also ends long polls and event streams when it stops.

    A second signal requeues running jobs at once.
    """

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app

    def run(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until a signal."""
        for number in _STOP_SIGNALS:
            signal.signal(number, self.handle_exit)
        super().run(sockets)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application, accept requests, and log the addresses."""
        await super().startup(sockets)
        for bound in sockets or ():
            host, port = bound.getsockname()[:2]
            logger.info("unbend running on http://%s:%d", f"[{host}]" if ":" in host else host, port)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Start to stop; at a second signal, stop without waiting for running jobs."""
        service: Service | None = getattr(self._app.state, "service", None)
        if service and self.should_exit:
            service.runner.stop_now()
            return
        if service:
            service.runner.end_waits()
        super().handle_exit(sig, frame)


def bind(host: str, port: int) -> Sequence[socket.socket]:
    """Return sockets for every address of `host` on one port. They do not accept connections yet.

    Raises
    ------
    AddressError
        If an address is in use, or does not belong to this machine.
    """
    sockets: list[socket.socket] = []
    try:
        for family, kind, protocol, _, address in socket.getaddrinfo(
            host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        ):
            chosen = sockets[0].getsockname()[1] if sockets else port
            if bound := _bound(family, kind, protocol, (address[0], chosen, *address[2:])):
                sockets.append(bound)
    except OSError as error:
        for opened in sockets:
            opened.close()
        raise AddressError(f"cannot listen on {host} port {port}: {error.strerror}") from None
    if not sockets:
        raise AddressError(f"cannot listen on {host} port {port}: the address does not belong to this machine")
    return sockets


def _bound(family: int, kind: int, protocol: int, address: tuple[object, ...]) -> socket.socket | None:
    """Return a socket with this address; None if the machine lacks the address or its family."""
    try:
        made = socket.socket(family, kind, protocol)
    except OSError:
        return None
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        made.bind(address)
    except OSError as error:
        made.close()
        if error.errno == errno.EADDRNOTAVAIL:
            return None
        raise
    made.set_inheritable(False)
    return made
