"""The job runner with real worker processes, which compute, fail, are stopped and are killed."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from tests.support.server import DAMAGED, endless_mesh, is_running, medium_mesh, ply, small_mesh, two_rings, workers_of
from unbend import Library, MeshPolicy, Parameters, compute_signature, read_mesh
from unbend.errors import JobTimeoutError, NotFoundError, ParameterError, QueueFullError
from unbend.jobs.limits import JobLimits
from unbend.jobs.observer import NoObserver
from unbend.jobs.runner import JobRunner
from unbend.jobs.worker import StoredMesh, convert, geodesics_from
from unbend.library.job_rows import JobFilter
from unbend.library.records import JobRecord
from unbend.library.requests import QueryRequest, ShapeRequest, Upload
from unbend.mesh.shapes import sphere, torus
from unbend.results.shapes import ShapeRecord

FEW = Parameters(samples=40)
MANY = Parameters(samples=2000)
READ = MeshPolicy()
PATIENCE = 120.0
"""Timeout in seconds, which only a hanging test reaches."""

ENDLESS = endless_mesh()
LIMITS = JobLimits(drain_seconds=0.0)


async def submit(
    runner: JobRunner, data: bytes, parameters: Parameters = FEW, **details: object
) -> JobRecord | ShapeRecord:
    request = ShapeRequest(**{"name": "a mesh"} | details)
    return await runner.submit_shape(Upload(data, "ply", parameters, READ), request)


async def queue(runner: JobRunner, data: bytes, parameters: Parameters = FEW, **details: object) -> str:
    """Submit a shape that is not stored yet; return the id of its job."""
    job = await submit(runner, data, parameters, **details)
    assert isinstance(job, JobRecord)
    return job.id


async def end(runner: JobRunner, job_id: str) -> JobRecord:
    job = await runner.wait(job_id, PATIENCE)
    assert job.finished, job
    return job


async def until(runner: JobRunner, job_id: str, reached: Callable[[JobRecord], bool]) -> JobRecord:
    async with asyncio.timeout(PATIENCE):
        while True:
            job = await runner.status(job_id)
            if reached(job):
                return job
            assert not job.finished, job
            await asyncio.sleep(0.02)


def computing(job: JobRecord) -> bool:
    return job.state == "running" and job.stage in {"sampling", "geodesics", "embedding"}


async def until_true(reached: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE):
        while not reached():
            await asyncio.sleep(0.02)


def rows(library: Library, table: str) -> int:
    with library.store.read() as connection:
        return connection.exec_driver_sql(f"SELECT count(*) FROM {table}").scalar_one()  # noqa: S608


def workers(besides: list[int] | tuple[int, ...] = ()) -> list[int]:
    """Return the worker processes of this process, except those in `besides`."""
    return [pid for pid in workers_of(os.getpid()) if pid not in besides]


@pytest.fixture(params=["sqlite", "postgresql"])
def library(request, tmp_path):
    url = str(tmp_path / "library.db") if request.param == "sqlite" else request.getfixturevalue("postgres_url")
    with Library(url) as opened:
        yield opened


@pytest.fixture(scope="module")
def loop():
    """An event loop that all tests of this module share."""
    with asyncio.Runner() as runner:
        yield runner.run


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def shared(request, tmp_path_factory, loop):
    """A runner with one worker, for tests that leave it idle."""
    url = str(tmp_path_factory.mktemp("jobs") / "library.db")
    if request.param == "postgresql":
        url = request.getfixturevalue("postgres").copy(request.getfixturevalue("empty_postgres_library"))
    with Library(url) as opened:
        runner = JobRunner(opened, workers=1, limits=LIMITS)
        loop(runner.start())
        yield runner, opened
        loop(runner.stop())


def run_with(library: Library, limits: JobLimits, story: Callable[[JobRunner], Awaitable[None]]) -> None:
    """Start a runner with one worker, run `story` with it, and stop it."""

    async def whole() -> None:
        runner = JobRunner(library, workers=1, limits=limits)
        await runner.start()
        try:
            await story(runner)
        finally:
            async with asyncio.timeout(PATIENCE):
                await runner.stop()

    asyncio.run(whole())


def test_a_job_becomes_a_shape_equal_to_one_added_directly(shared, loop):
    runner, library = shared
    data = ply(torus(columns=12, rows=9))

    async def story() -> JobRecord:
        return await end(runner, await queue(runner, data, name="ring", label="torus", metadata={"n": 1}))

    job = loop(story())
    assert (job.state, job.stage, job.progress, job.attempts, job.error) == ("succeeded", "done", 1.0, 1, None)
    assert job.created_at <= job.started_at <= job.finished_at
    shape = library.get(job.shape_id)
    assert (shape.name, shape.label, shape.metadata) == ("ring", "torus", {"n": 1})
    assert library.mesh(shape.id) == data
    expected = compute_signature(read_mesh(data), FEW)
    assert (library.signature(shape.id).points == expected.points).all()


def test_the_runner_becomes_ready_and_is_alive(shared, loop):
    runner, _ = shared

    async def story() -> None:
        await until_true(lambda: runner.ready)
        await until_true(lambda: runner.running == 0)

    loop(story())
    assert runner.alive


def test_submitting_a_stored_mesh_returns_its_shape(shared, loop):
    runner, library = shared
    shape = library.add(small_mesh(1), parameters=FEW)
    assert loop(submit(runner, small_mesh(1))) == shape


@pytest.mark.parametrize(
    ("data", "code", "says"),
    [
        (DAMAGED, "mesh_read", "ends early"),
        (b"ply\nnonsense", "mesh_read", "header"),
        (b"OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n", "mesh_geometry", ""),
    ],
    ids=["cut short", "nonsense", "without area"],
)
def test_a_damaged_mesh_fails_with_its_code_and_the_next_job_runs(shared, loop, data, code, says):
    runner, library = shared
    before = rows(library, "meshes")

    async def story() -> tuple[JobRecord, JobRecord]:
        bad = await queue(runner, data)
        good = await queue(runner, small_mesh(100 + len(data)))
        return await end(runner, bad), await end(runner, good)

    bad, good = loop(story())
    assert (bad.state, bad.attempts, bad.shape_id) == ("failed", 1, None)
    assert bad.error["code"] == code
    assert says in bad.error["message"]
    assert bad.error["advice"]
    assert good.state == "succeeded"
    assert rows(library, "meshes") == before + 1  # the mesh of the failed job is deleted


def test_equal_meshes_submitted_together_are_computed_once(shared, loop):
    runner, library = shared
    data = medium_mesh()

    async def story() -> list[JobRecord]:
        answers = await asyncio.gather(*(submit(runner, data) for _ in range(12)))
        other = await queue(runner, data, Parameters(samples=41))
        assert len({answer.id for answer in answers} | {other}) == 13  # each upload has its own job
        assert (await runner.cancel(answers[0].id)).state == "cancelled"
        ended = [await end(runner, answer.id) for answer in answers[1:]]
        (shape_id,) = {job.shape_id for job in ended}
        assert {job.state for job in ended} == {"succeeded"}
        assert (await submit(runner, data)).id == shape_id
        assert (await end(runner, other)).shape_id != shape_id
        return ended

    before = len(library)
    jobs = loop(story())
    assert len(library) == before + 2
    times = sorted((job.finished_at - job.started_at).total_seconds() for job in jobs)
    assert sum(times[:-1]) < times[-1]  # only one job computed


def test_a_mesh_is_read_by_the_policy_of_its_job(shared, loop):
    runner, library = shared
    policies = [MeshPolicy(), MeshPolicy(components="bridge"), MeshPolicy(components="error")]

    async def story() -> list[JobRecord]:
        uploads = [Upload(ply(two_rings(0)), "ply", FEW, policy) for policy in policies]
        request = ShapeRequest("rings")
        jobs = [await runner.submit_shape(upload, request) for upload in uploads]
        return [await end(runner, job.id) for job in jobs]

    largest, bridged, refused = loop(story())
    assert (refused.state, refused.error["code"]) == ("failed", "mesh_geometry")
    assert "2 components" in refused.error["message"]
    shapes = [library.get(job.shape_id) for job in (largest, bridged)]
    assert [shape.policy for shape in shapes] == policies[:2]
    surfaces = [read_mesh(ply(two_rings(0)), policy=policy) for policy in policies[:2]]
    assert [shape.area for shape in shapes] == [surface.area for surface in surfaces]


def test_a_query_returns_a_ranking_and_stores_no_mesh(shared, loop):
    runner, library = shared
    library.add(small_mesh(2), label="torus", name="near", parameters=FEW)
    library.add(ply(sphere(subdivisions=1)), label="sphere", name="far", parameters=FEW)
    data = small_mesh(3)
    before = (rows(library, "meshes"), len(library))

    async def story() -> JobRecord:
        job = await runner.submit_query(Upload(data, "ply", FEW, READ), QueryRequest("moments", k=1))
        return await end(runner, job.id)

    job = loop(story())
    expected = library.rank(compute_signature(read_mesh(data), FEW), measure="moments", k=1).as_dict()
    assert (job.state, job.shape_id, job.result) == ("succeeded", None, expected)
    assert len(job.result["shapes"]) == 1
    assert (rows(library, "meshes"), len(library)) == before


def test_a_query_with_a_stored_mesh_finds_and_keeps_that_shape(shared, loop):
    runner, library = shared
    shape = library.add(small_mesh(4), parameters=FEW)

    async def story() -> JobRecord:
        job = await runner.submit_query(Upload(small_mesh(4), "ply", FEW, READ), QueryRequest("spectrum", k=1))
        return await end(runner, job.id)

    expected = {"id": shape.id, "name": shape.name, "label": None, "distance": 0.0, "part": None}
    assert loop(story()).result["shapes"][0] == expected
    assert library.mesh(shape.id) == small_mesh(4)


def test_progress_increases_through_the_stages(shared, loop):
    runner, _ = shared

    details: list[tuple[str, dict[str, float]]] = []

    async def story() -> list[tuple[str, float]]:
        job_id = await queue(runner, ply(torus(columns=82, rows=60)), Parameters(samples=300))
        seen = []

        def look(job: JobRecord) -> bool:
            seen.append((job.stage, job.progress))
            details.append((job.stage, job.detail))
            return job.finished

        await until(runner, job_id, look)
        return seen

    seen = loop(story())
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    rows = [detail["row"] for stage, detail in details if stage == "geodesics"]
    assert rows == sorted(rows)
    assert 0 < rows[-1] <= 300
    assert details[-1] == ("done", {})
    order = ["queued", "starting", "reading", "repairing", "sampling", "geodesics", "embedding", "describing", "done"]
    assert [stage for stage in order if stage in stages] == stages
    assert "geodesics" in stages
    shares = [share for _, share in seen]
    assert shares == sorted(shares)
    assert len(set(shares)) > 5
    assert shares[-1] == 1.0


def test_cancelling_stops_a_running_job_and_drops_a_queued_one(shared, loop):
    runner, library = shared
    before = rows(library, "meshes")

    async def story() -> None:
        running = await queue(runner, ENDLESS, MANY)
        waiting = [await queue(runner, small_mesh(30 + number)) for number in range(4)]
        await until(runner, running, computing)
        assert [(await runner.status(job_id)).state for job_id in waiting[-2:]] == ["queued", "queued"]
        assert await runner.position(await runner.status(waiting[-1])) == await runner.queued() - 1
        last = await runner.cancel(waiting[-1])
        assert (last.state, last.attempts, last.error["code"]) == ("cancelled", 0, "job_cancelled")
        first = await runner.cancel(running)
        assert (first.state, first.attempts, first.error["code"]) == ("cancelled", 1, "job_cancelled")
        for job_id in waiting[:-1]:
            assert (await end(runner, job_id)).state == "succeeded"
        assert await runner.cancel(waiting[0]) == await runner.status(waiting[0])
        assert (await runner.status(running)).state == "cancelled"

    loop(story())
    assert rows(library, "meshes") == before + 3


def test_a_cancelled_job_stops_computing_within_a_second(shared, loop):
    runner, _ = shared

    async def story() -> None:
        job_id = await queue(runner, ENDLESS, MANY)
        await until(runner, job_id, computing)
        (busy,) = workers()
        await until_true(lambda: seconds_computed(busy) > 1.0)
        begun = time.monotonic()
        await runner.cancel(job_id)
        while is_running(busy):
            await asyncio.sleep(0.005)
        assert time.monotonic() - begun < 1.0

    loop(story())


def seconds_computed(pid: int) -> float:
    values = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(values[11]) + int(values[12])) / os.sysconf("SC_CLK_TCK")


def test_waiting_for_a_job_ends_with_its_cancellation_or_a_timeout(shared, loop):
    runner, _ = shared

    async def story() -> None:
        job_id = await queue(runner, ENDLESS, MANY)
        await until(runner, job_id, computing)
        assert (await runner.wait(job_id, 0.05)).state == "running"
        waiting = [asyncio.create_task(runner.wait(job_id, PATIENCE)) for _ in range(3)]
        await asyncio.sleep(0)
        await runner.cancel(job_id)
        async with asyncio.timeout(PATIENCE / 2):
            assert [job.state for job in await asyncio.gather(*waiting)] == ["cancelled"] * 3

    loop(story())


def test_a_job_whose_worker_is_killed_is_repeated(shared, loop):
    runner, library = shared

    async def story() -> JobRecord:
        job_id = await queue(runner, ply(torus(columns=84, rows=60)), Parameters(samples=300))
        other = await queue(runner, small_mesh(40))
        await until(runner, job_id, computing)
        (worker,) = workers()
        os.kill(worker, signal.SIGKILL)
        ended = await end(runner, job_id)
        assert (await end(runner, other)).state == "succeeded"
        assert worker not in workers()
        return ended

    job = loop(story())
    assert (job.state, job.attempts) == ("succeeded", 2)
    assert library.get(job.shape_id).sha256


def test_a_job_that_loses_two_workers_fails(shared, loop):
    runner, _ = shared

    async def story() -> tuple[JobRecord, JobRecord]:
        job_id = await queue(runner, ENDLESS, MANY)
        for attempt in (1, 2):
            await until(runner, job_id, lambda job, n=attempt: job.attempts == n and computing(job))
            (worker,) = workers()
            os.kill(worker, signal.SIGKILL)
        return await end(runner, job_id), await end(runner, await queue(runner, small_mesh(41)))

    job, after = loop(story())
    assert (job.state, job.attempts, job.error["code"]) == ("failed", 2, "worker_lost")
    assert after.state == "succeeded"


def test_calls_on_stored_meshes_return_results_and_raise_typed_errors(shared, loop):
    runner, library = shared
    shape = library.add(small_mesh(5), parameters=FEW)
    mesh = StoredMesh(library.address, shape.sha256, "ply", READ)
    geodesics = loop(runner.call(geodesics_from, mesh, "spherical", 0))
    assert geodesics.distances[0] == 0.0
    assert len(geodesics.distances) == 60
    assert geodesics.path is None
    with pytest.raises(ParameterError):
        loop(runner.call(geodesics_from, mesh, "spherical", 60))
    with pytest.raises(NotFoundError):
        loop(runner.call(convert, StoredMesh(mesh.library, "0" * 64, "ply", READ), "off"))


def test_an_unknown_job_is_not_found(shared, loop):
    runner, _ = shared
    for call in (runner.status, runner.cancel, lambda job_id: runner.wait(job_id, 1.0)):
        with pytest.raises(NotFoundError, match="no job nobody"):
            loop(call("nobody"))


def test_jobs_are_listed_newest_first_and_by_state(shared, loop):
    runner, _ = shared

    async def story() -> None:
        bad = await queue(runner, DAMAGED + b"# of the list")
        good = await queue(runner, small_mesh(50))
        await end(runner, bad)
        await end(runner, good)
        page, _ = await runner.page(JobFilter(), cursor=None, limit=2)
        assert [job.id for job in page.items] == [good, bad]
        page, _ = await runner.page(JobFilter(state="failed"), cursor=None, limit=1)
        assert page.items[0].id == bad
        page, _ = await runner.page(JobFilter(state="succeeded"), cursor=None, limit=500)
        assert {job.state for job in page.items} == {"succeeded"}

    loop(story())


def test_a_full_queue_refuses_jobs_until_one_leaves_it(library):
    async def story(runner: JobRunner) -> None:
        first = await queue(runner, ENDLESS, MANY)
        await until(runner, first, computing)
        second = await queue(runner, small_mesh(0))
        await until(runner, second, lambda job: job.state == "running")  # claimed, and waiting for the process
        third = await queue(runner, small_mesh(1))
        assert await runner.queued() == 1
        with pytest.raises(QueueFullError) as caught:
            await queue(runner, small_mesh(2))
        assert caught.value.retry_after >= 1
        assert rows(library, "meshes") == 3
        await runner.cancel(third)
        fourth = await queue(runner, small_mesh(2))
        await runner.cancel(first)
        assert (await end(runner, fourth)).state == "succeeded"

    run_with(library, JobLimits(queued=1, drain_seconds=0.0), story)


def test_a_job_beyond_its_time_limit_fails_and_the_next_job_runs(library):
    async def story(runner: JobRunner) -> None:
        await until_true(lambda: runner.ready)
        long, after = await queue(runner, ENDLESS, MANY), await queue(runner, small_mesh(0))
        job = await end(runner, long)
        assert (job.state, job.attempts, job.error["code"]) == ("failed", 1, "job_timeout")
        assert "4.5 seconds" in job.error["message"]
        assert (await end(runner, after)).state == "succeeded"
        with pytest.raises(JobTimeoutError, match=r"4\.5 seconds"):
            await runner.call(time.sleep, PATIENCE)
        shape = library.page().items[0]
        mesh = StoredMesh(library.address, shape.sha256, "ply", READ)
        assert (await call_until_in_time(runner, convert, mesh, "off")).startswith(b"OFF")

    run_with(library, JobLimits(seconds=4.5, call_seconds=4.5, drain_seconds=0.0), story)


async def call_until_in_time(runner: JobRunner, *call: Any) -> Any:
    """Repeat a call until the restarted process answers in time."""
    async with asyncio.timeout(PATIENCE):
        while True:
            with contextlib.suppress(JobTimeoutError):
                return await runner.call(*call)


def test_a_job_beyond_its_memory_limit_fails_and_the_next_job_runs(library):
    async def story(runner: JobRunner) -> None:
        large = await end(runner, await queue(runner, ply(torus(columns=700, rows=400))))
        assert (large.state, large.attempts, large.error["code"]) == ("failed", 1, "job_memory")
        assert (await end(runner, await queue(runner, small_mesh(0)))).state == "succeeded"

    # An idle worker takes about 720 MB of address space; below that, its libraries end the process instead of raising.
    run_with(library, JobLimits(memory_mb=1000, drain_seconds=0.0), story)


def test_stopping_requeues_a_running_job_and_the_next_runner_finishes_it(library):
    ids: list[str] = []
    before = workers()

    async def story(runner: JobRunner) -> None:
        ids.append(await queue(runner, medium_mesh(), Parameters(samples=500), name="kept"))
        await until(runner, ids[0], computing)
        ids.append(await queue(runner, small_mesh(0)))
        assert workers(besides=before)

    run_with(library, LIMITS, story)
    assert workers(besides=before) == []

    async def begin_again(runner: JobRunner) -> None:
        assert all([(await runner.status(job_id)).attempts <= 1 for job_id in ids])
        jobs = [await end(runner, job_id) for job_id in ids]
        assert [(job.state, job.attempts) for job in jobs] == [("succeeded", 1)] * 2
        assert library.get(jobs[0].shape_id).name == "kept"

    with library.store.read() as connection:
        found = connection.exec_driver_sql("SELECT state, stage, attempts, started_at FROM jobs ORDER BY seq").all()
    assert [tuple(row) for row in found] == [("queued", "queued", 0, None)] * 2
    run_with(library, LIMITS, begin_again)


def test_stopping_waits_for_running_jobs_within_the_drain_time(library):
    ids: list[str] = []

    async def story(runner: JobRunner) -> None:
        ids.append(await queue(runner, medium_mesh()))
        await until(runner, ids[0], computing)

    run_with(library, JobLimits(drain_seconds=PATIENCE), story)
    assert len(library) == 1


@pytest.mark.parametrize("library", ["sqlite"], indirect=True)  # tests/cluster kills the servers of the other
def test_jobs_of_a_killed_server_run_again_up_to_the_limit_of_restarts(library):
    ids: list[str] = []

    async def leave(runner: JobRunner) -> None:
        ids.extend([await queue(runner, small_mesh(number), Parameters(samples=30)) for number in range(3)])

    async def take_up(runner: JobRunner) -> None:
        again, untouched, lost = [await end(runner, job_id) for job_id in ids]
        assert (again.state, again.attempts, again.restarts) == ("succeeded", 1, 1)
        assert (untouched.state, untouched.attempts) == ("succeeded", 1)
        assert (lost.state, lost.restarts, lost.error["code"]) == ("failed", 2, "worker_lost")

    run_without_starting(library, leave)
    with library.store.write() as connection:  # the state that a killed server leaves
        for seq, restarts in ((1, 0), (3, 2)):
            connection.exec_driver_sql(
                "UPDATE jobs SET state = 'running', attempts = 1, restarts = ? WHERE seq = ?", (restarts, seq)
            )
    run_with(library, JobLimits(restarts=2, drain_seconds=0.0), take_up)
    assert rows(library, "meshes") == 2


def run_without_starting(library: Library, story: Callable[[JobRunner], Awaitable[None]]) -> None:
    async def whole() -> None:
        runner = JobRunner(library, workers=1, limits=LIMITS)
        await story(runner)
        await runner.stop()

    asyncio.run(whole())


def test_a_runner_becomes_ready_although_a_starting_worker_was_killed(library):
    before = workers()

    async def story(runner: JobRunner) -> None:
        await until_true(lambda: bool(workers(besides=before)))
        (worker,) = workers(besides=before)
        os.kill(worker, signal.SIGKILL)
        assert (await end(runner, await queue(runner, small_mesh(0)))).state == "succeeded"
        async with asyncio.timeout(20):
            while not runner.ready:
                await asyncio.sleep(0.05)

    run_with(library, LIMITS, story)


def test_another_measure_for_the_same_file_computes_nothing_again(tmp_path):
    class Counter(NoObserver):
        computed_jobs = 0

        def computed(self, _seconds):
            self.computed_jobs += 1

    counter = Counter()

    async def run(library: Library) -> list[JobRecord]:
        runner = JobRunner(library, workers=1, limits=LIMITS, observer=counter)
        await runner.start()
        await end(runner, await queue(runner, small_mesh(1)))
        ended = []
        for measure, parameters in (("spectrum", FEW), ("moments", FEW), ("moments", Parameters(samples=41))):
            job = await runner.submit_query(Upload(small_mesh(2), "ply", parameters, READ), QueryRequest(measure))
            ended.append(await end(runner, job.id))
        await runner.stop()
        return ended

    with Library(str(tmp_path / "a.db")) as library:
        first, second, third = asyncio.run(run(library))
    assert counter.computed_jobs == 3  # the shape, the first query, and the query with other parameters
    assert [job.result["measure"] for job in (first, second)] == ["spectrum", "moments"]
    assert first.result["shapes"][0]["distance"] != second.result["shapes"][0]["distance"]
    assert third.result["shapes"] == []


def test_a_ticket_whose_return_the_database_interrupts_is_returned_again(postgres, postgres_url):
    name = postgres_url.partition("?")[0].rpartition("/")[2]
    waiting = f"FROM pg_stat_activity WHERE datname = '{name}' AND wait_event_type = 'Lock'"
    with Library(postgres_url) as library:

        async def story(runner: JobRunner) -> None:
            job_id = await queue(runner, medium_mesh(), Parameters(samples=500))
            await until(runner, job_id, computing)
            with library.store.write() as connection:
                connection.exec_driver_sql("SELECT id FROM procrastinate_jobs FOR UPDATE").one()
                assert (await end(runner, job_id)).state == "succeeded"
                await until_true(lambda: bool(postgres.execute(f"SELECT pid {waiting}")))
                postgres.execute(f"SELECT pg_terminate_backend(pid) {waiting}")
            await until_true(lambda: rows(library, "procrastinate_jobs") == 0)

        run_with(library, LIMITS, story)


def test_late_news_of_a_job_do_not_lower_its_progress(postgres_url):
    with Library(postgres_url) as library:

        def announce(news: dict[str, object]) -> None:
            with library.store.write() as connection:
                connection.exec_driver_sql("SELECT pg_notify('unbend_jobs', %s)", (json.dumps(news),))

        async def story(runner: JobRunner) -> None:
            job_id = await queue(runner, ENDLESS, MANY)
            reached = (await until(runner, job_id, computing)).progress
            announce({"job": job_id, "state": "queued"})
            announce({"job": job_id, "progress": {"stage": "starting"}})
            announce({"worker": {"id": "another", "processes": 7, "running": 0}})
            await until_true(lambda: runner.capacity[0] >= 7)  # whatever was announced before is heard
            assert (await runner.status(job_id)).progress >= reached > 0
            await runner.cancel(job_id)

        run_with(library, LIMITS, story)
