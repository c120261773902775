"""Uploads: files are read while they are sent, report their progress, and are sent again from the beginning."""

from __future__ import annotations

import asyncio
import re
import socket
import threading
import tracemalloc
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.support.server import DAMAGED
from unbend import AsyncClient, Client
from unbend.client.uploads import MeshFile
from unbend.errors import MeshFormatError, MeshReadError, ParameterError

PROBLEM = b'{"code":"mesh_format","detail":"no mesh"}'
REFUSED = (
    b"HTTP/1.1 415 Unsupported Media Type\r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % len(PROBLEM) + PROBLEM
)
LARGE = 30_000_000


class Receiver(threading.Thread):
    """Receives requests whole, drops the connections of the first ones, and refuses the others."""

    def __init__(self, drops: int) -> None:
        super().__init__(daemon=True)
        self._drops = drops
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.sizes: list[int] = []
        """Bytes of the body of each request."""
        self.start()

    def run(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                with connection:
                    self.sizes.append(self._receive(connection))
                    if len(self.sizes) > self._drops:
                        connection.sendall(REFUSED)

    def _receive(self, connection: socket.socket) -> int:
        data = b""
        while b"\r\n\r\n" not in data:
            data += connection.recv(65536)
        head, _, rest = data.partition(b"\r\n\r\n")
        wanted, received = int(re.search(rb"content-length: (\d+)", head, re.IGNORECASE)[1]), len(rest)
        while received < wanted and (piece := connection.recv(65536)):
            received += len(piece)
        return received

    def close(self) -> None:
        self._listener.close()


@pytest.fixture(params=[0, 2], ids=["at once", "after two broken connections"])
def receiver(request) -> Iterator[Receiver]:
    made = Receiver(request.param)
    yield made
    made.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    large = tmp_path / "large.off"
    large.write_bytes(b"OFF\n" + bytes(LARGE - 4))
    return large


def send(kind: str, url: str, path: Path, progress) -> None:
    if kind == "sync":
        with Client(url) as client:
            client.submit(path, progress=progress)
        return

    async def story() -> None:
        async with AsyncClient(url) as client:
            await client.submit(path, progress=progress)

    asyncio.run(story())


@pytest.mark.parametrize("kind", ["sync", "async"])
def test_a_file_is_streamed_with_its_progress_and_whole_at_each_attempt(receiver, kind, path):
    reported: list[tuple[int, int]] = []
    tracemalloc.start()
    with pytest.raises(MeshFormatError):
        send(kind, receiver.url, path, lambda sent, size: reported.append((sent, size)))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < LARGE / 2
    attempts = len(receiver.sizes)
    assert all(LARGE < size < LARGE + 2000 for size in receiver.sizes)
    assert {size for _, size in reported} == {LARGE}
    sent = [number for number, _ in reported]
    assert sent.count(LARGE) == attempts
    first = sent[: sent.index(LARGE) + 1]
    assert first == sorted(first)
    assert len(first) > 100


def test_the_file_is_closed_after_a_refused_request(path):
    with MeshFile.of(path) as file:
        assert file.read(3) == b"OFF"
    with pytest.raises(ValueError, match="closed"):
        file.read(1)


def test_a_file_that_is_missing_or_opened_as_text_is_refused_before_anything_is_sent(tmp_path):
    with Client("http://127.0.0.1:9") as client:
        with pytest.raises(FileNotFoundError):
            client.submit(tmp_path / "missing.off")
        text = tmp_path / "text.off"
        text.write_bytes(DAMAGED)
        with text.open() as file, pytest.raises(ParameterError, match="'rb'"):
            client.submit(file)


@pytest.mark.parametrize("change", ["grows", "shrinks"])
def test_a_file_that_changes_while_it_is_sent_is_an_error_of_the_file(path, change):
    receiver = Receiver(0)

    def progress(sent: int, _size: int) -> None:
        if sent < LARGE // 2:
            with path.open("r+b") as file:
                file.truncate(LARGE * 2 if change == "grows" else LARGE // 2)

    with Client(receiver.url) as client, pytest.raises(MeshReadError, match=r"large\.off changed while it was sent"):
        client.submit(path, progress=progress)
    receiver.close()


@pytest.mark.parametrize(
    "details",
    [{"name": "\udce9"}, {"label": "\udce9"}, {"metadata": {"a": {1}}}, {"metadata": {"a": "\udce9"}}],
    ids=str,
)
def test_a_description_that_cannot_be_sent_is_refused(details):
    with Client("http://127.0.0.1:9") as client:
        with pytest.raises(ParameterError, match="cannot represent"):
            client.add(DAMAGED, **details)
        with pytest.raises(ParameterError, match="cannot represent"):
            client.change("0" * 32, **details)
