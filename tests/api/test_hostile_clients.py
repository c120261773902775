"""Clients that send too much, too slowly, nonsense, or nothing: the server never hangs, and serves other clients."""

from __future__ import annotations

import contextlib
import http.client
import io
import json
import resource
import shlex
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, post_mesh, slow_mesh, small_mesh, stored
from unbend import Library

FEW = json.dumps(SAMPLES)
MEGABYTE = 2**20
FORM = b"Content-Type: multipart/form-data; boundary=b\r\n"
PART = b'--b\r\nContent-Disposition: form-data; name="file"; filename="x.ply"\r\n\r\n'
HEAD, STALL, TRANSFER = 1.0, 1.0, 3.0


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    """A server with short timeouts that accepts 2 megabytes per upload, and 6 in all requests together."""
    folder = tmp_path_factory.mktemp("hostile")
    settings = {"head_seconds": HEAD, "stall_seconds": STALL, "transfer_seconds": TRANSFER}
    sizes = {"max_upload_mb": 2, "max_arriving_mb": 6, "max_waiting": 20}
    with Server(folder, workers=1, **settings, **sizes) as running:
        yield running


@pytest.fixture(scope="module")
def api(server):
    with server.http() as client:
        yield client


class Wire:
    """A raw connection, on which a test can send any bytes."""

    def __init__(self, server: Server, *said: bytes, buffer: int = 0) -> None:
        address = urlsplit(server.url)
        self.socket = socket.socket()
        self.socket.settimeout(20)
        if buffer:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        self.socket.connect((address.hostname, address.port))
        for part in said:
            self.say(part)

    def __enter__(self) -> Wire:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def say(self, data: bytes) -> None:
        self.socket.sendall(data)

    def say_until_refused(self, data: bytes, seconds: float = 15.0) -> int:
        """Send repeatedly until the server closes the connection or time is up; return how many bytes were sent."""
        end, sent = time.monotonic() + seconds, 0
        with contextlib.suppress(ConnectionError):
            while time.monotonic() < end:
                sent += self.socket.send(data)
        return sent

    def answer(self, method: str = "GET") -> httpx.Response:
        """Read one response, and nothing of the next one."""
        response = http.client.HTTPResponse(self, method=method)
        response.begin()
        return httpx.Response(response.status, headers=response.getheaders(), content=response.read())

    def makefile(self, mode: str) -> io.RawIOBase:
        return self.socket.makefile(mode, buffering=0)

    def rest(self) -> bytes:
        """Read until the server closes the connection."""
        parts = []
        with contextlib.suppress(ConnectionError):
            while part := self.socket.recv(MEGABYTE):
                parts.append(part)
        return b"".join(parts)


def head(method: str = "POST", path: str = "/v1/shapes", *headers: bytes, version: bytes = b"1.1") -> bytes:
    first = f"{method} {path} HTTP/".encode() + version + b"\r\nHost: 127.0.0.1\r\n"
    return first + b"".join(line if line.endswith(b"\r\n") else line + b"\r\n" for line in headers) + b"\r\n"


def status(process: int, name: str) -> int:
    """Return a number in /proc/PID/status."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith(f"{name}:")))


def handles(server: Server) -> int:
    return len(list(Path(f"/proc/{server.process.pid}/fd").iterdir()))


def until(condition, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def jobs(api: httpx.Client) -> list[str]:
    return [job["id"] for job in api.get("/v1/jobs", params={"limit": 500}).json()["items"]]


def temporary_files(server: Server) -> list[str]:
    """Return the server's open temporary files, including files that are already unlinked."""
    opened = []
    for handle in Path(f"/proc/{server.process.pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            opened.append(str(handle.readlink()))
    folder = str(server.temporary)
    return [name for name in opened if name.startswith(folder)]


# Too much


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries", "/v1/nothing"])
def test_a_content_length_beyond_the_limit_is_refused_before_the_body(server, path):
    with Wire(server, head("POST", path, FORM, b"Content-Length: 3000000", b"Expect: 100-continue")) as wire:
        response = wire.answer()
        check(response, 413, "upload_too_large")
        assert response.headers["connection"] == "close"
        assert wire.rest() == b""


def test_a_client_that_sends_a_refused_body_can_still_read_the_answer(server):
    with Wire(server, head("POST", "/v1/shapes", FORM, b"Content-Length: 9000000000")) as wire:
        sent = wire.say_until_refused(bytes(MEGABYTE), seconds=2.0)
        assert sent > 2 * MEGABYTE  # the server discards the body, because a reset could destroy the answer
        check(wire.answer(), 413, "upload_too_large")
        begun = time.monotonic()
        wire.say_until_refused(bytes(MEGABYTE))
        assert time.monotonic() - begun < 8


def test_an_upload_with_expect_continue_is_accepted(server):
    body = PART + small_mesh(1) + b"\r\n--b--\r\n"
    announced = head("POST", "/v1/shapes", FORM, f"Content-Length: {len(body)}".encode(), b"Expect: 100-continue")
    with Wire(server, announced) as wire:
        assert wire.socket.recv(100).startswith(b"HTTP/1.1 100 ")
        wire.say(body)
        assert wire.answer().status_code == 202


def test_a_chunked_upload_beyond_the_limit_is_refused_and_leaves_no_files(server, api):
    before, held = jobs(api), status(server.process.pid, "VmRSS")
    chunk = b"%x\r\n" % 700_000 + bytes(700_000) + b"\r\n"
    with Wire(server, head("POST", "/v1/shapes", FORM, b"Transfer-Encoding: chunked")) as wire:
        wire.say(b"%x\r\n" % len(PART) + PART + b"\r\n")
        wire.say(chunk * 2)
        until(lambda: temporary_files(server))  # uploads above one megabyte are written to a file
        with contextlib.suppress(ConnectionError):
            for _ in range(3):
                wire.say(chunk)
        response = wire.answer()
        check(response, 413, "upload_too_large")
        assert response.headers["connection"] == "close"
    assert temporary_files(server) == []
    assert list((server.temporary).glob("tmp*")) == []
    assert jobs(api) == before
    assert status(server.process.pid, "VmRSS") - held < 16 * 1024


@pytest.mark.parametrize("method", ["GET", "DELETE", "POST"])
def test_an_endless_body_that_no_route_reads_is_cut_off(server, method):
    with Wire(server, head(method, "/v1/shapes/x", b"Transfer-Encoding: chunked")) as wire:
        begun = time.monotonic()
        wire.say_until_refused(b"10000\r\n" + bytes(65536) + b"\r\n")
        assert time.monotonic() - begun < 8


def test_uploads_beyond_the_total_limit_are_refused_as_busy(server, api):
    begun = head("POST", "/v1/shapes", FORM, b"Content-Length: 2000000") + PART + bytes(1_900_000)
    with contextlib.ExitStack() as stack:
        wires = [stack.enter_context(Wire(server, begun)) for _ in range(5)]
        answers = [wire.answer() for wire in wires]
    refused = [response for response in answers if response.status_code == 503]
    assert refused
    for response in refused:
        check(response, 503, "busy")
        assert int(response.headers["retry-after"]) >= 1
    assert {response.status_code for response in answers} <= {408, 503}
    assert post_mesh(api, small_mesh(2), parameters=FEW).status_code == 202


FORMS = {
    "many fields": (b'--b\r\nContent-Disposition: form-data; name="n"\r\n\r\n\r\n' * 3000, 400),
    "many files": (PART.replace(b"--b", b"\r\n--b") * 3000, 400),
    "a huge field": (b'--b\r\nContent-Disposition: form-data; name="label"\r\n\r\n' + b"x" * 1_500_000, 400),
    "a huge name": (b'--b\r\nContent-Disposition: form-data; name="' + b"x" * 1_500_000 + b'"\r\n\r\n', 400),
    "many headers": (b"--b\r\n" + b"A: b\r\n" * 200_000, 400),
    "no file": (b"--b--\r\n", 422),
}  # fmt: skip


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
@pytest.mark.parametrize("name", FORMS)
def test_excessive_forms_are_refused_quickly(api, path, name):
    body, expected = FORMS[name]
    begun = time.monotonic()
    headers = {"Content-Type": "multipart/form-data; boundary=b"}
    response = api.post(path, content=body + b"\r\n--b--\r\n", headers=headers)
    check(response, expected, "bad_request" if expected == 400 else "request_invalid")
    assert time.monotonic() - begun < 5


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
def test_a_very_long_boundary_is_refused(api, path):
    boundary = "b" * 10_000
    headers = {"Content-Type": f"multipart/form-data; boundary={boundary}"}
    body = f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="x"\r\n\r\n'.encode() + bytes(10**6)
    check(api.post(path, content=body, headers=headers), 400, "bad_request")


# Not HTTP


CODES = {
    400: "bad_request",
    431: "request_header_fields_too_large",
    501: "not_implemented",
    505: "http_version_not_supported",
}
MALFORMED = {
    "nonsense": (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", 400),
    "another version": (b"GET /v1/livez HTTP/2.0\r\nHost: x\r\n\r\n", 505),
    "a negative length": (head("POST", "/v1/shapes", b"Content-Length: -1"), 400),
    "a length that is no number": (head("POST", "/v1/shapes", b"Content-Length: 0x10"), 400),
    "two lengths": (head("POST", "/v1/shapes", b"Content-Length: 5", b"Content-Length: 6"), 400),
    "a list of lengths": (head("POST", "/v1/shapes", b"Content-Length: 5, 6"), 400),
    "a length and chunks": (head("POST", "/v1/shapes", b"Content-Length: 5", b"Transfer-Encoding: chunked"), 400),
    "chunks in HTTP/1.0": (head("POST", "/v1/shapes", b"Transfer-Encoding: chunked", version=b"1.0"), 400),
    "an unknown encoding": (head("POST", "/v1/shapes", b"Transfer-Encoding: xchunked"), 501),
    "two encodings": (head("POST", "/v1/shapes", b"Transfer-Encoding: gzip, chunked"), 501),
    "no host": (b"GET /v1/livez HTTP/1.1\r\n\r\n", 400),
    "a folded header": (head("GET", "/v1/livez", b"X: y\r\n z"), 200),
    "a space before the colon": (head("GET", "/v1/livez", b"X : y"), 400),
    "a zero byte": (head("GET", "/v1/livez", b"X: a\0b"), 400),
    "a long path": (head("GET", "/v1/" + "x" * 100_000), 431),
    "a long header": (head("GET", "/v1/livez", b"Authorization: Bearer " + b"x" * MEGABYTE), 431),
    "many headers": (head("GET", "/v1/livez", *(b"X%d: y" % n for n in range(20_000))), 431),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_and_excessive_http_is_answered_and_closed(server, name):
    said, expected = MALFORMED[name]
    with Wire(server) as wire:
        with contextlib.suppress(ConnectionError):
            wire.say(said)
        response = wire.answer()
        if expected == 200:
            assert response.status_code == 200
            return
        check(response, expected, CODES[expected])
        assert response.headers["connection"] == "close"
        assert response.headers["x-content-type-options"] == "nosniff"
        assert response.headers["x-request-id"]
        assert wire.rest() == b""


@pytest.mark.parametrize("broken", [b"zz\r\n", b"5\r\nabcdeXX", b"-1\r\n", b"1" * 30 + b"\r\n"])
def test_malformed_chunks_end_the_upload(server, api, broken):
    before = jobs(api)
    with Wire(server, head("POST", "/v1/shapes", FORM, b"Transfer-Encoding: chunked"), broken) as wire:
        check(wire.answer(), 400, "bad_request")
    assert jobs(api) == before


def test_bytes_after_the_content_length_are_the_next_request(server):
    body = PART + small_mesh(3) + b"\r\n--b--\r\n"
    with Wire(server, head("POST", "/v1/shapes", FORM, f"Content-Length: {len(body)}".encode()), body) as wire:
        wire.say(b"and more\r\n\r\n")
        first = wire.answer()
        assert first.status_code in {200, 202}
        check(wire.answer(), 400, "bad_request")


def test_pipelined_requests_are_answered_in_order(server):
    paths = ["/v1/livez", "/v1/nothing", "/v1/livez", "/v1/shapes/x"] * 10
    with Wire(server, b"".join(head("GET", path) for path in paths)) as wire:
        assert [wire.answer().status_code for _ in paths] == [200, 404, 200, 404] * 10


def test_http_1_0_and_head_are_answered(server):
    with Wire(server, head("GET", "/v1/livez", version=b"1.0")) as wire:
        assert wire.answer().status_code == 200
        assert wire.rest() == b""
    with Wire(server, head("HEAD", "/v1/livez"), head("GET", "/v1/livez")) as wire:
        assert wire.answer("HEAD").status_code == 200
        assert wire.answer().status_code == 200


# Too many

MANY = 10_000


def allowed_handles() -> int:
    """Return how many file descriptors this process and its children may have."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    return most


@pytest.fixture
def all_handles() -> Iterator[None]:
    soft, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, most))


def check_is_served(api: httpx.Client, number: int) -> None:
    """Check that the server answers a GET and an upload within seconds."""
    begun = time.monotonic()
    assert api.get("/v1/livez").status_code == 200
    assert post_mesh(api, small_mesh(number), parameters=FEW).status_code in {200, 202}
    assert time.monotonic() - begun < 10


def test_ten_thousand_idle_connections_do_not_block_other_clients(tmp_path, all_handles):
    """A third sends nothing, a third half a head, a third half a body. A low limit on descriptors lowers the number."""
    count = min(MANY, allowed_handles() * 3 // 4 - 16)
    silent, half = (b"",), (b"GET /v1/livez HTTP/1.1\r\nHost",)
    body = head("POST", "/v1/shapes", FORM, b"Content-Length: 100000"), PART
    kinds = silent, half, body
    with Server(tmp_path, workers=1, ready=False) as server, server.http() as api:
        check_is_served(api, 10)
        opened, held = handles(server), status(server.process.pid, "VmRSS")
        with contextlib.ExitStack() as stack:
            for number in range(count):
                stack.enter_context(Wire(server, *kinds[number % len(kinds)]))
            until(lambda: handles(server) > count // 2)  # on a slow machine the first connections have timed out
            check_is_served(api, 11)
            assert (status(server.process.pid, "VmRSS") - held) * 1024 < count * 40_000
        until(lambda: handles(server) <= opened + 8)
        check_is_served(api, 12)


def test_connections_beyond_the_limit_evict_the_longest_idle_ones(tmp_path):
    with Server(tmp_path, workers=1, ready=False, max_connections=20) as server, server.http() as api:
        half = head("POST", "/v1/shapes", FORM, b"Content-Length: 100000"), PART
        with contextlib.ExitStack() as stack:
            bodies = [stack.enter_context(Wire(server, *half)) for _ in range(10)]
            silent = [stack.enter_context(Wire(server)) for _ in range(10)]
            time.sleep(1.2)
            check_is_served(api, 20)
            assert silent[0].rest() == b""
            for _ in range(30):
                stack.enter_context(Wire(server, *half))
            check(bodies[0].answer(), 503, "service_unavailable")

            check_is_served(api, 21)


def test_a_low_limit_on_file_descriptors_lowers_the_limit_on_connections(tmp_path, monkeypatch):
    """The limit on connections stays below the limit on file descriptors, so that accepting never fails."""
    limited = f'ulimit -n 256; exec {shlex.quote(sys.executable)} "$@"'
    program = tmp_path / "python"
    program.write_text(f"#!/bin/sh\n{limited}\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(Server(tmp_path / "server", workers=1, ready=False))
        api = stack.enter_context(server.http())
        for _ in range(400):
            stack.enter_context(Wire(server))
        check_is_served(api, 30)
        assert handles(server) < 256
        assert "Too many open files" not in server.log.read_text()


# Too slow


def test_a_connection_without_a_complete_head_times_out(server):
    with Wire(server) as silent, Wire(server, b"GET /v1/livez HTTP/1.1\r\n") as half:
        begun = time.monotonic()
        check(half.answer(), 408, "request_timeout")
        assert silent.rest() == b""
        assert HEAD / 2 < time.monotonic() - begun < HEAD + 3


def test_a_connection_with_a_trickling_head_times_out(server):
    with Wire(server, b"GET /v1/livez HTTP/1.1\r\n") as wire:
        begun = time.monotonic()
        with contextlib.suppress(ConnectionError):
            while time.monotonic() - begun < HEAD + 1:
                wire.say(b"A: b\r\n")
                time.sleep(0.1)
        check(wire.answer(), 408, "request_timeout")
        assert time.monotonic() - begun < HEAD + 3


def test_the_head_of_a_second_request_also_times_out(server):
    with Wire(server, head("GET", "/v1/livez")) as wire:
        assert wire.answer().status_code == 200
        wire.say(b"GET ")
        check(wire.answer(), 408, "request_timeout")


def test_an_upload_that_stalls_times_out(server, api):
    before = jobs(api)
    with Wire(server, head("POST", "/v1/shapes", FORM, b"Content-Length: 100000"), PART) as wire:
        begun = time.monotonic()
        response = wire.answer()
        check(response, 408, "upload_too_slow")
        assert response.headers["connection"] == "close"
        assert STALL / 2 < time.monotonic() - begun < STALL + 3
    assert jobs(api) == before


def test_an_upload_that_trickles_times_out(server):
    with Wire(server, head("POST", "/v1/queries", FORM, b"Content-Length: 100000"), PART) as wire:
        begun = time.monotonic()
        while time.monotonic() - begun < TRANSFER + 0.3:
            wire.say(b"x")
            time.sleep(0.2)
        check(wire.answer(), 408, "upload_too_slow")
        assert time.monotonic() - begun < TRANSFER + 3


def test_a_slow_upload_within_the_limits_is_accepted(server):
    body = PART + small_mesh(4) + b"\r\n--b--\r\n"
    size = len(body) // 4 + 1
    with Wire(server, head("POST", "/v1/shapes", FORM, f"Content-Length: {len(body)}".encode())) as wire:
        for first in range(0, len(body), size):
            wire.say(body[first : first + size])
            time.sleep(STALL / 2)
        assert wire.answer().status_code in {200, 202}


@pytest.mark.parametrize("count", [2, 20])
def test_a_response_that_the_client_does_not_read_times_out(server, api, count):
    """Socket buffers hold up to about two megabytes; the rest waits in the server."""
    padded = small_mesh(5).replace(b"format", b"comment " + b"x" * 1_900_000 + b"\nformat", 1)
    path = f"/v1/shapes/{stored(api, padded, parameters=FEW)['id']}/mesh"
    with Wire(server, buffer=4096) as wire:
        wire.say(head("GET", path) * (count - 1) + head("GET", path, b"Connection: close"))
        time.sleep(2 * STALL + 1)
        assert 0 < len(wire.rest()) < 2 * 1_900_000
    assert api.get("/v1/livez").status_code == 200


# Gone


def test_an_aborted_upload_leaves_no_file_and_no_job(server, api):
    before, opened = jobs(api), handles(server)
    with Wire(server, head("POST", "/v1/shapes", FORM, b"Content-Length: 1900000"), PART, bytes(1_500_000)):
        until(lambda: temporary_files(server))
    until(lambda: not temporary_files(server))
    until(lambda: handles(server) <= opened)
    assert jobs(api) == before


def test_a_client_that_disconnects_while_waiting_frees_its_slot(server, api):
    job = post_mesh(api, slow_mesh(), parameters=json.dumps({"samples": 4000})).json()
    waiting = [f"/v1/jobs/{job['id']}/events", f"/v1/jobs/{job['id']}?wait=3"] * 10
    # A starting worker and the first read of the store open file descriptors that stay open.
    until(lambda: api.get(f"/v1/jobs/{job['id']}").json()["state"] == "running", seconds=60)
    opened = handles(server)
    try:
        with contextlib.ExitStack() as stack:
            for path in waiting:
                stack.enter_context(Wire(server, head("GET", path)))
            until(lambda: api.get(f"/v1/jobs/{job['id']}", params={"wait": 0.01}).status_code == 503)
            check(api.get(f"/v1/jobs/{job['id']}/events"), 503, "busy")
            assert api.get(f"/v1/jobs/{job['id']}").status_code == 200
        until(lambda: handles(server) <= opened)
        until(lambda: api.get(f"/v1/jobs/{job['id']}", params={"wait": 0.01}).status_code == 200)
        assert "unbend_event_streams 0.0" in api.get("/v1/metrics").text
    finally:
        api.delete(f"/v1/jobs/{job['id']}")


# Wrong keys


def test_wrong_keys_get_one_answer_and_are_rate_limited(tmp_path):
    with Library(str(tmp_path / "library.db")) as library:
        _, good = library.keys.create("good", "read")
        _, revoked = library.keys.create("revoked", "read")
        library.keys.revoke(revoked.split("_", 2)[1])
    other = f"{good[:-6]}AAAAAA"
    with Server(tmp_path, workers=1, ready=False, requests_per_minute=30) as server, server.http() as api:

        def asked(authorization: str) -> httpx.Response:
            return api.get("/v1/shapes", headers={"Authorization": authorization})

        wrong = ["", "Bearer", f"Basic {good}", good, f"Bearer {revoked}", f"Bearer {other}", "Bearer " + "x" * 10_000]
        problems = [check(asked(text), 401, "key_invalid") for text in wrong]
        assert all(problem == problems[0] for problem in problems)
        answers = [asked(f"Bearer {other}") for _ in range(40)]
        assert {response.status_code for response in answers} == {401, 429}
        check(answers[-1], 429, "rate_limited")
        assert asked(f"Bearer {good}").status_code == 200  # valid keys from the same address are not locked out
