"""When a client repeats a request: against a real socket that breaks, and by the table of its rules."""

from __future__ import annotations

import socket
import threading
from contextlib import closing

import httpx
import pytest

from unbend import Client
from unbend.client import Job
from unbend.client.retries import Attempts
from unbend.errors import NotFoundError, QueueFullError, ServiceError
from unbend.results import JobStatus


class Breaking(threading.Thread):
    """A server that closes the first connections without an answer, and then gives one response for ever."""

    def __init__(self, broken: int, response: bytes) -> None:
        super().__init__(daemon=True)
        self._broken, self._response = broken, response
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.requests: list[bytes] = []
        self.start()

    def run(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection:
                self.requests.append(connection.recv(65536))
                if len(self.requests) > self._broken:
                    connection.sendall(self._response)

    def close(self) -> None:
        self._listener.close()


EMPTY = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 12\r\nConnection: close\r\n\r\n"
CLASSES = EMPTY + b'{"items":[]}'
PROBLEM = b'{"code":"queue_full","detail":"too many jobs wait"}'
FULL = (
    b"HTTP/1.1 429 Too Many Requests\r\nRetry-After: 1\r\nContent-Length: %d\r\nConnection: close\r\n\r\n"
    % len(PROBLEM)
    + PROBLEM
)


def test_reading_is_repeated_after_broken_connections():
    with closing(Breaking(2, CLASSES)) as server, Client(server.url) as client:
        assert client.labels() == {}
        assert len(server.requests) == 3


def test_a_request_without_an_idempotency_key_is_sent_once():
    with closing(Breaking(9, CLASSES)) as server, Client(server.url) as client:
        with pytest.raises(ServiceError, match="could not be reached"):
            client.request("POST", "/v1/demo")
        assert len(server.requests) == 1


@pytest.mark.parametrize(
    "send",
    [
        lambda client: client.submit(b"OFF"),
        lambda client: client.rank("0" * 32),
        lambda client: client.match("0" * 32, "1" * 32),
    ],
    ids=["upload", "query", "match"],
)
def test_what_makes_a_job_is_repeated_with_the_same_key(send):
    with closing(Breaking(9, CLASSES)) as server, Client(server.url) as client:
        with pytest.raises(ServiceError, match="could not be reached"):
            send(client)
        keys = {line for each in server.requests for line in each.splitlines() if line.startswith(b"Idempotency-Key")}
        assert (len(server.requests), len(keys)) == (5, 1)


def test_a_shape_that_is_gone_after_a_lost_answer_was_removed():
    body = b'{"code":"not_found","detail":"no such shape"}'
    gone = b"HTTP/1.1 404 Not Found\r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % len(body) + body
    with closing(Breaking(1, gone)) as server, Client(server.url) as client:
        client.remove("0" * 32)
        assert len(server.requests) == 2
    server = Breaking(0, gone)
    with closing(server), Client(server.url) as client, pytest.raises(NotFoundError, match="no such shape"):
        client.remove("0" * 32)


def job_response(state: str) -> bytes:
    body = b'{"id":"1","kind":"shape","state":"%s"}' % state.encode()
    return b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % len(body) + body


def test_a_wait_of_no_time_asks_for_the_present_state():
    queued = JobStatus("1", "shape", "queued")
    with closing(Breaking(0, job_response("succeeded"))) as server, Client(server.url) as client:
        assert Job(client, queued).wait(0).state == "succeeded"
    with closing(Breaking(0, job_response("running"))) as server, Client(server.url) as client:
        with pytest.raises(TimeoutError, match="job 1 is running after 0 seconds"):
            Job(client, queued).wait(0)
        assert len(server.requests) == 1


def test_waiting_at_a_limit_ends():
    with closing(Breaking(0, FULL)) as server, Client(server.url, retry_seconds=0.5) as client:
        with pytest.raises(QueueFullError, match="too many jobs wait") as caught:
            client.labels()
        assert (caught.value.status, len(server.requests)) == (429, 1)


def test_pauses_honour_the_service_and_grow_after_failures():
    attempts = Attempts(repeatable=True)
    limited = attempts.pause_after(httpx.Response(429, headers={"Retry-After": "7"}))
    assert limited is not None
    assert 7.0 <= limited <= 10.5
    pauses = [attempts.pause_after(httpx.Response(502)) for _ in range(5)]
    assert pauses[-1] is None
    assert all(2.0**n / 4 <= pause <= 1.5 * 2.0**n / 4 for n, pause in enumerate(pauses[:-1]) if pause is not None)
    assert attempts.pause_after(httpx.Response(200)) is None
    assert Attempts(repeatable=False).pause_after(httpx.Response(502)) is None
    assert Attempts(repeatable=False).pause_after_error(httpx.ReadError("cut")) is None
    assert Attempts(repeatable=False).pause_after_error(httpx.ConnectError("refused")) is not None
