"""The event stream of a job: each change is sent once, also across reconnections, and the stream ends with the job."""

from __future__ import annotations

import asyncio
import json
import signal
import threading
import time
import uuid
from collections.abc import Iterator

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.support.server import (
    DAMAGED,
    ENDLESS,
    Server,
    ended,
    endless_mesh,
    medium_mesh,
    post_mesh,
    small_mesh,
    stored,
)
from unbend import Library, MeshPolicy, Parameters
from unbend.api.routes.events import event_id, events
from unbend.jobs.runner import JobRunner
from unbend.library.requests import ShapeRequest, Upload
from unbend.progress import STAGES

FEW = '{"samples": 27}'
"""Parameters that no other test on the shared server uses."""
PATIENCE = 60.0
ORDER = ("queued", *STAGES, "done")


@pytest.fixture(scope="module")
def http(server) -> Iterator[httpx.Client]:
    with server.http() as client:
        yield client


def parsed(lines: Iterator[str]) -> Iterator[tuple[int, dict]]:
    """Yield the events of a stream as (id, job)."""
    fields: dict[str, str] = {}
    for line in lines:
        if line:
            name, _, value = line.partition(": ")
            assert name in {"id", "data", "retry", ""}, line
            fields[name] = value
        elif "data" in fields:
            yield int(fields["id"]), json.loads(fields["data"])
            fields = {}


def read_events(http: httpx.Client, url: str, last: int | None = None) -> list[tuple[int, dict]]:
    """Return all events of a job to its end, from now or after the event `last`."""
    headers = {} if last is None else {"Last-Event-ID": str(last)}
    with http.stream("GET", f"{url}/events", headers=headers) as response:
        assert response.status_code == 200
        return list(parsed(response.iter_lines()))


def endless(http: httpx.Client, dimensions: int) -> str:
    parameters = json.dumps(ENDLESS | {"dimensions": dimensions})
    return post_mesh(http, endless_mesh(), parameters=parameters).headers["Location"]


def test_each_change_of_a_job_is_one_event_and_the_last_event_is_its_end(http):
    url = post_mesh(http, medium_mesh(), parameters='{"samples": 301}').headers["Location"]
    begun = time.monotonic()
    reported = read_events(http, url)
    seconds = time.monotonic() - begun
    ids, jobs = [number for number, _ in reported], [job for _, job in reported]
    assert ids == sorted(set(ids))
    places = [(ORDER.index(job["stage"]), job["progress"]) for job in jobs]
    assert places == sorted(set(places))
    assert [job["state"] for job in jobs].count("succeeded") == 1
    assert jobs[-1] == http.get(url).json()
    assert len(reported) <= 4 * seconds + 3  # only the first event, the start and the end are not rate-limited


def test_event_streams_forbid_caching_and_buffering_and_set_the_retry_time(http):
    url = ended(http, post_mesh(http, small_mesh(1), parameters=FEW))["id"]
    response = http.get(f"/v1/jobs/{url}/events")
    assert response.headers["content-type"] == "text/event-stream; charset=utf-8"
    assert (response.headers["cache-control"], response.headers["x-accel-buffering"]) == ("no-store", "no")
    assert response.text.startswith("retry: 2000\n\nid: ")


def test_the_stream_of_an_ended_job_has_one_event(http):
    job = ended(http, post_mesh(http, DAMAGED, file_name="bad.off"))
    url = f"/v1/jobs/{job['id']}"
    ((number, reported),) = read_events(http, url)
    assert reported == job
    assert reported["error"]["code"] == "mesh_read"
    again = http.get(f"{url}/events", headers={"Last-Event-ID": str(number)})
    assert (again.status_code, again.content) == (204, b"")


@pytest.mark.parametrize("last", ["", "x", "-1", "9" * 5000, "1.5"])
def test_an_invalid_last_event_id_is_ignored(http, last):
    shape = stored(http, small_mesh(2), parameters=FEW)
    job = next(job for job in http.get("/v1/jobs").json()["items"] if job["shape_id"] == shape["id"])
    response = http.get(f"/v1/jobs/{job['id']}/events", headers={"Last-Event-ID": last})
    assert [reported for _, reported in parsed(iter(response.text.split("\n")))] == [job | {"result": None}]


def test_events_of_an_unknown_job_are_not_found(http):
    response = http.get("/v1/jobs/nobody/events")
    assert response.status_code == 404
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["code"] == "not_found"


def test_line_separators_in_names_do_not_break_events(http):
    name = "a\u2028b\x85c\nd"
    own = '{"samples": 29}'
    stored(http, small_mesh(3), parameters=own, name=name)
    files = {"file": ("mesh.ply", small_mesh(3))}
    url = http.post("/v1/queries", files=files, data={"parameters": own}).headers["Location"]
    reported = read_events(http, url)
    assert reported[-1][1]["result"]["shapes"][0]["name"] == name


def test_every_listener_receives_the_end_of_a_cancelled_job_once(http, server):
    url = endless(http, 6)
    reported: list[list[tuple[int, dict]]] = [[], [], []]

    def listen(number: int) -> None:
        with server.http() as own:
            reported[number] = read_events(own, url)

    listeners = [threading.Thread(target=listen, args=(number,)) for number in range(3)]
    for listener in listeners:
        listener.start()
    until(lambda: open_streams(http) == 3)
    assert http.delete(url).json()["state"] == "cancelled"
    for listener in listeners:
        listener.join(PATIENCE)
    for received in reported:
        states = [job["state"] for _, job in received]
        assert states[-1] == "cancelled"
        assert not {"cancelled"} & set(states[:-1])
        assert len({number for number, _ in received}) == len(received)
    assert len({received[-1][0] for received in reported}) == 1


def test_a_stream_resumes_after_the_last_event_id_and_closes_with_its_client(http):
    url = endless(http, 7)
    try:
        with http.stream("GET", f"{url}/events") as response:
            stream = parsed(response.iter_lines())
            first = next(stream)
            second = next(stream)
        until(lambda: open_streams(http) == 0)
        assert http.get(url).json()["state"] in {"queued", "running"}
        with http.stream("GET", f"{url}/events", headers={"Last-Event-ID": str(second[0])}) as response:
            third = next(parsed(response.iter_lines()))
        assert first[0] < second[0] < third[0]
    finally:
        http.delete(url)


def test_a_stopping_server_ends_the_stream_and_the_next_server_resumes_it(tmp_path):
    with Server(tmp_path, workers=1, drain_seconds=0) as first, first.http() as http:
        url = endless(http, 3)
        with http.stream("GET", f"{url}/events") as response:
            stream = parsed(response.iter_lines())
            last = next(number for number, job in stream if job["stage"] == "geodesics")
            begun = time.monotonic()
            first.process.send_signal(signal.SIGTERM)
            for number, job in stream:  # the server ends the stream properly, so this loop raises no error
                assert job["state"] == "running"
                last = number
            assert time.monotonic() - begun < 3.0
        first.process.wait(20)
        assert "Traceback" not in first.log.read_text()
    headers = {"Last-Event-ID": str(last)}
    with (
        Server(tmp_path, workers=1, ready=False, drain_seconds=0) as second,
        second.http() as http,
        http.stream("GET", f"{url}/events", headers=headers) as response,
    ):
        stream = parsed(response.iter_lines())
        number, job = next(stream)
        assert number != last
        assert job["state"] in {"queued", "running"}
        http.delete(url)
        *_, (_, job) = stream
        assert job["state"] == "cancelled"


def test_a_silent_stream_has_heartbeats(tmp_path):
    async def story(library: Library) -> None:
        runner = JobRunner(library, workers=1)  # not started: the job waits
        upload = Upload(small_mesh(1), "ply", Parameters(samples=40), MeshPolicy())
        job = await runner.submit_shape(upload, ShapeRequest("n"))
        stream = events(runner, job.id, None, heartbeat=0.0)
        assert await anext(stream) == "retry: 2000\n\n"
        assert (await anext(stream)).startswith(f"id: {event_id(job)}\n")
        assert [await anext(stream) for _ in range(2)] == [": nothing new\n\n"] * 2
        patient = events(runner, job.id, event_id(job))
        await anext(patient)
        following = asyncio.create_task(anext(patient))
        await asyncio.sleep(1.0)
        assert not following.done()
        cancelled = await runner.cancel(job.id)
        assert (await following).startswith(f"id: {event_id(cancelled)}\n")
        assert [part async for part in patient] == []
        with pytest.raises(LookupError):
            await anext(runner.follow(uuid.uuid4().hex))
        await runner.stop()

    with Library(str(tmp_path / "library.db")) as library:
        asyncio.run(story(library))


def open_streams(http: httpx.Client) -> float:
    families = text_string_to_metric_families(http.get("/v1/metrics").text)
    return next(family.samples[0].value for family in families if family.name == "unbend_event_streams")


def until(reached) -> None:
    end = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.05)
