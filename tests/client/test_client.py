"""The synchronous and the asynchronous client against a real server; most tests run with both."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.support.clients import make_client
from tests.support.server import (
    DAMAGED,
    ENDLESS,
    SAMPLES,
    endless_mesh,
    medium_mesh,
    ply,
    post_mesh,
    slow_mesh,
    small_mesh,
    two_rings,
)
from unbend import AsyncClient, Client, Parameters, compute_signature, errors, read_mesh
from unbend.client import protocol
from unbend.errors import (
    JobCancelledError,
    MeshFormatError,
    MeshGeometryError,
    MeshReadError,
    NotFoundError,
    ParameterError,
    ServiceError,
)
from unbend.results import JobFailure, JobStatus

PATIENCE = 120.0


@pytest.fixture(params=["sync", "async"])
def kind(request) -> str:
    return request.param


@pytest.fixture
def client(kind, server):
    made, close = make_client(kind, server.url)
    yield made
    close()


@pytest.fixture
def mesh(kind):
    """A function that makes meshes which no other test sends, different for each kind of client."""
    base = {"sync": 400, "async": 450}[kind]
    return lambda number: small_mesh(base + number)


def test_a_submitted_mesh_becomes_a_shape(client, mesh, tmp_path):
    path = tmp_path / "my ring.ply"
    path.write_bytes(mesh(0))
    job = client.submit(path, label="torus", metadata={"n": 1}, parameters=SAMPLES)
    assert job.status().state in {"queued", "running", "succeeded"}
    ended = job.wait(PATIENCE)
    assert (ended.id, ended.state) == (job.id, "succeeded")
    assert job.status() == ended
    shape = job.result()
    assert (shape.name, shape.label, shape.metadata) == ("my ring", "torus", {"n": 1})
    assert client.get(shape.id) == shape
    expected = compute_signature(read_mesh(mesh(0)), Parameters(**SAMPLES))
    assert client.signature(shape.id).points.tolist() == expected.points.tolist()
    assert client.job(job.id).result(PATIENCE) == shape


def test_a_stored_mesh_is_returned_at_once(client, mesh):
    shape = client.submit(mesh(1), name="first", parameters=SAMPLES).result(PATIENCE)
    again = client.submit(mesh(1), name="second", parameters=SAMPLES)
    assert again.status().state == "succeeded"
    assert again.wait(0).shape_id == shape.id
    known = again.result(0)
    assert (known, known.is_new, known.ignored) == (shape, False, ("name",))
    renamed = client.submit(mesh(1), name="second", parameters=SAMPLES, if_known="update").result(0)
    assert (renamed.name, renamed.updated, renamed.id) == ("second", ("name",), shape.id)


def test_cancelling_the_upload_of_a_stored_mesh_changes_nothing(client, mesh):
    shape = client.submit(mesh(1), parameters=SAMPLES).result(PATIENCE)
    again = client.submit(mesh(1), parameters=SAMPLES)
    assert again.cancel().state == "succeeded"
    assert again.result().id == shape.id


def test_a_failed_job_raises_the_same_error_as_reading_the_mesh(client):
    with pytest.raises(MeshReadError, match="ends early"):
        client.submit(DAMAGED).result(PATIENCE)
    with pytest.raises(MeshGeometryError):
        client.submit(b"OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n").result(PATIENCE)
    with pytest.raises(MeshReadError, match="ends early"):
        client.rank(DAMAGED, timeout=PATIENCE)


def test_waiting_raises_a_timeout_and_a_cancelled_job_raises_its_error(client, kind):
    job = client.submit(endless_mesh(), parameters=ENDLESS | {"dimensions": {"sync": 4, "async": 5}[kind]})
    try:
        for patience in (0.0, 0.5):
            with pytest.raises(TimeoutError):
                job.wait(patience)
        with pytest.raises(TimeoutError):
            job.result(0.1)
        assert job.status().state in {"queued", "running"}
    finally:
        cancelled = job.cancel()
    assert cancelled.state == "cancelled"
    assert job.status() == cancelled
    with pytest.raises(JobCancelledError):
        job.result()


def test_a_refused_request_raises_the_error_of_the_library_with_the_problem(client):
    with pytest.raises(ParameterError, match="samples") as caught:
        client.submit(small_mesh(0), parameters={"samples": 1})
    assert (caught.value.status, caught.value.problem["code"]) == (422, "parameter_invalid")
    with pytest.raises(MeshFormatError) as caught:
        client.submit(b"no mesh")
    assert (caught.value.status, caught.value.advice) == (415, MeshFormatError.advice)
    with pytest.raises(ParameterError, match="k") as caught:
        client.rank(small_mesh(0), k=0)
    assert caught.value.problem["code"] == "request_invalid"


def test_an_unknown_id_raises_not_found(client):
    nobody = uuid.uuid4().hex
    for call in (client.get, client.job, client.remove, client.signature, client.mesh, client.rank, client.change):
        with pytest.raises(NotFoundError, match=nobody):
            call(nobody)


def test_a_shape_can_be_changed_and_removed(client, mesh):
    shape = client.submit(mesh(2), parameters=SAMPLES).result(PATIENCE)
    changed = client.change(shape.id, name="x", label=None)
    assert (changed.name, changed.label, changed.id) == ("x", None, shape.id)
    assert changed.updated_at > shape.updated_at
    assert changed.revision > shape.revision
    client.remove(shape.id)
    with pytest.raises(NotFoundError):
        client.get(shape.id)


def test_queries_rank_shapes_with_the_same_parameters(client, mesh, kind):
    own = {"samples": {"sync": 33, "async": 34}[kind]}
    ids = [client.submit(mesh(number), label="ring", parameters=own).result(PATIENCE).id for number in (3, 5)]
    ranking = client.rank(mesh(3), k=1, measure="moments", parameters=own)
    assert (ranking.measure, ranking.classes[0].label) == ("moments", "ring")
    assert [(match.id, match.distance) for match in ranking.shapes] == [(ids[0], 0.0)]
    assert [match.id for match in client.nearest(ids[0])] == [ids[1]]


def test_a_mesh_is_read_by_its_policy(client, kind):
    own = {"samples": {"sync": 31, "async": 32}[kind]}
    data = ply(two_rings({"sync": 0, "async": 1}[kind]))
    bridge = {"components": "bridge", "max_vertices": 70, "smooth": 2, "seams": "keep"}
    shape = client.submit(data, parameters=own, policy=bridge).result(PATIENCE)
    assert shape.policy.as_dict() == bridge
    assert (shape.report["links"], shape.report["components"]) == (1, 2)
    assert client.rank(data, parameters=own, policy=bridge).shapes[0].distance == 0.0
    assert client.rank(data, parameters=own).shapes[0].distance > 0.0
    with pytest.raises(MeshGeometryError, match="2 components"):
        client.submit(data, policy={"components": "error"}).result(PATIENCE)
    for call in (client.submit, client.rank):
        with pytest.raises(ParameterError, match="max_vertices") as caught:
            call(data, policy={"max_vertices": 0})
        assert caught.value.status == 422


def test_shapes_of_a_label_are_listed_in_order(client, mesh, server, kind):
    label = uuid.uuid4().hex
    ids = [client.submit(mesh(number), label=label, parameters=SAMPLES).result(PATIENCE).id for number in (6, 7, 8)]
    assert [shape.id for shape in client.iter_shapes(label=label)] == ids
    assert client.labels()[label] == 3
    everything = [shape.id for shape in client.iter_shapes()]
    assert set(ids) <= set(everything)
    assert len(everything) == len(set(everything))
    assert list(client.iter_shapes(label="nobody's")) == []


def test_an_unreachable_service_raises_a_service_error(kind):
    made, close = make_client(kind, "http://127.0.0.1:9")
    with pytest.raises(ServiceError, match=r"the service at http://127\.0\.0\.1:9 could not be reached") as caught:
        made.labels()
    assert caught.value.status is None
    close()


def test_the_address_comes_from_the_environment(server, monkeypatch):
    monkeypatch.delenv("UNBEND_URL", raising=False)
    with pytest.raises(ServiceError, match="set UNBEND_URL"):
        Client()
    monkeypatch.setenv("UNBEND_URL", server.url)
    with Client() as made:
        assert isinstance(made.labels(), dict)


def test_a_mesh_in_memory_is_uploaded(client, mesh, kind):
    surface = read_mesh(mesh(13))
    shape = client.submit(surface, parameters=Parameters(**SAMPLES)).result(PATIENCE)
    expected = compute_signature(surface, SAMPLES)
    assert client.signature(shape.id).points.tolist() == expected.points.tolist()
    assert client.rank((surface.vertices, surface.faces), parameters=SAMPLES).shapes[0].distance == 0.0


@pytest.mark.parametrize("address", ["127.0.0.1:8000", "ftp://127.0.0.1", "http://host:port", ""])
def test_an_invalid_url_raises_a_service_error(kind, address):
    def call() -> None:
        made, close = make_client(kind, address)
        try:
            made.labels()
        finally:
            close()

    with pytest.raises(ServiceError):
        call()


def test_a_client_is_closed_at_the_end_of_its_context(server):
    with Client(server.url) as client:
        client.labels()
    with pytest.raises(ServiceError, match="the client is closed"):
        client.labels()

    async def story() -> None:
        async with AsyncClient(server.url) as client:
            await client.labels()
        with pytest.raises(ServiceError, match="the client is closed"):
            await client.labels()

    asyncio.run(story())


def test_shapes_beyond_one_page_are_all_yielded_in_order(client, server):
    label = uuid.uuid4().hex
    with Client(server.url) as sender:
        sent = [
            sender.submit(
                small_mesh(number), label=label, name=str(number), parameters={"samples": 4}, if_known="update"
            )
            for number in range(120)
        ]
        assert {job.wait(PATIENCE).state for job in sent} == {"succeeded"}
    found = list(client.iter_shapes(label=label))
    assert {shape.name for shape in found} == {str(number) for number in range(120)}
    assert [shape.seq for shape in found] == sorted({shape.seq for shape in found})
    assert len(found) == 120


def test_an_upload_waits_while_the_queue_is_full(small_server, kind):
    made, close = make_client(kind, small_server.url)
    base = {"sync": 70, "async": 80}[kind]
    blocking = []
    with Client(small_server.url) as other, small_server.http() as http:

        def cancel_all() -> None:
            for job in blocking:
                job.cancel()

        later = threading.Timer(0.5, cancel_all)
        try:
            for samples in (3000, 3001):
                blocking.append(other.submit(slow_mesh(), parameters={"samples": samples + base}))
                until_running(blocking[-1])
            blocking.append(other.submit(small_mesh(base), parameters=SAMPLES))
            assert post_mesh(http, small_mesh(base + 1), parameters=json.dumps(SAMPLES)).status_code == 429
            later.start()
            shape = made.submit(small_mesh(base + 2), name="patient", parameters=SAMPLES).result(PATIENCE)
            later.join()
        finally:
            cancel_all()
            close()
    assert shape.name == "patient"


def until_running(job) -> None:
    end = time.monotonic() + 60
    while job.status().state == "queued":
        assert time.monotonic() < end
        time.sleep(0.02)


def test_the_events_of_a_job_end_with_its_result(client, mesh, kind):
    job = client.submit(mesh(12), parameters=SAMPLES)
    reported = list(job.events())
    assert reported[-1].state == "succeeded"
    assert job.status() == reported[-1]
    assert list(job.events()) == [reported[-1]]
    again = client.job(job.id)
    assert list(again.events()) == [reported[-1]]
    stored = client.submit(mesh(12), parameters=SAMPLES)
    (whole,) = stored.events()
    assert (whole.shape_id, whole.state, whole.progress, whole.kind) == (
        reported[-1].shape_id,
        "succeeded",
        1.0,
        "shape",
    )
    assert whole.finished_at is not None
    with pytest.raises(NotFoundError, match="nobody"):
        list(client.job_events("nobody"))


class CuttingRelay(threading.Thread):
    """Relays connections to a server, and cuts event streams off after `limit` bytes."""

    def __init__(self, url: str, limit: int) -> None:
        super().__init__(daemon=True)
        self._target = (urlsplit(url).hostname, urlsplit(url).port)
        self._limit = limit
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.heads: list[bytes] = []
        """The heads of requests for events."""

    def run(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(near,), daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _serve(self, near: socket.socket) -> None:
        with near, socket.create_connection(self._target) as far:
            threading.Thread(target=self._requests, args=(near, far), daemon=True).start()
            events, passed = False, 0
            for data in received(far):
                events = events or b"text/event-stream" in data
                passed += len(data)
                near.sendall(data)
                if events and passed > self._limit:
                    near.shutdown(socket.SHUT_RDWR)
                    return

    def _requests(self, near: socket.socket, far: socket.socket) -> None:
        with suppress(OSError):
            for data in received(near):
                if b"/events HTTP" in data:
                    self.heads.append(data)
                far.sendall(data)


def received(source: socket.socket) -> Iterator[bytes]:
    with suppress(ConnectionError):
        while data := source.recv(65536):
            yield data


def test_a_broken_event_stream_is_resumed_without_repeated_events(server, kind):
    with closing(CuttingRelay(server.url, limit=1500)) as relay:  # the head and one or two events
        relay.start()
        made, close = make_client(kind, relay.url)
        reported = list(made.submit(medium_mesh(), parameters={"samples": {"sync": 302, "async": 303}[kind]}).events())
        close()
    assert reported[-1].state == "succeeded"
    places = [(job.state, job.stage, job.progress) for job in reported]
    assert len(set(places)) == len(places)
    assert len(relay.heads) > 1
    assert b"last-event-id" not in relay.heads[0].lower()
    assert all(b"last-event-id: " in head.lower() for head in relay.heads[1:])


def test_events_of_an_unreachable_service_raise_a_service_error(kind):
    made, close = make_client(kind, "http://127.0.0.1:9")
    with pytest.raises(ServiceError, match="could not be reached"):
        list(made.job_events("x"))
    close()


def test_seams_are_stitched_and_a_dropped_component_is_a_warning(client, kind, tmp_path):
    cube = Path(__file__).parents[1] / "mesh" / "cases" / "ply_flat_cube_24.ply"
    own = {"samples": {"sync": 6, "async": 7}[kind]}
    shape = client.submit(cube, parameters=own).result(PATIENCE)
    assert (shape.report["seams"], shape.warnings) == (12, [])
    kept = client.submit(cube, parameters=own | {"samples": 4}, policy={"seams": "keep"}).result(PATIENCE)
    assert "of the area was kept" in kept.warnings[0]
    ranking = client.rank(cube, parameters=own | {"samples": 4}, policy={"seams": "keep"})
    assert list(ranking.warnings) == kept.warnings


def test_a_file_name_that_is_not_utf8_is_escaped(client, mesh, kind, tmp_path):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/m\xe9" + kind.encode() + b".ply"))
    path.write_bytes(mesh(40))
    shape = client.submit(path, parameters={"samples": {"sync": 8, "async": 9}[kind]}).result(PATIENCE)
    assert shape.name == rf"m\xe9{kind}"


@pytest.mark.parametrize("kind", sorted(errors.subclasses(errors.JobError), key=lambda kind: kind.code))
def test_a_failed_job_raises_its_own_error(kind):
    failed = JobStatus("1", "shape", "failed", error=JobFailure(kind.code, "why"))
    with pytest.raises(kind, match="why") as raised:
        protocol.outcome(failed)
    assert type(raised.value) is kind


def test_a_job_that_failed_for_a_reason_of_a_later_service_has_no_result():
    failed = JobStatus("1", "shape", "failed", error=JobFailure("a_later_code", "why", "what to do"))
    with pytest.raises(errors.JobError, match="why") as raised:
        protocol.outcome(failed)
    assert raised.value.advice == "what to do"


@pytest.mark.parametrize("code", ["mesh_too_large", "unsuited", "store_full"])
def test_the_client_raises_errors_of_meshes_parameters_and_stores(code):
    with pytest.raises(errors.UnbendError) as raised:
        protocol.outcome(JobStatus("1", "shape", "failed", error=JobFailure(code, "why")))
    assert raised.value.code == code
