"""Jobs and their observers when transactions are rolled back and when servers stop."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
from contextlib import closing

import pytest
from sqlalchemy import Connection

from tests.support.server import small_mesh
from unbend import Library, Parameters
from unbend.errors import StoreFullError
from unbend.jobs.limits import JobLimits
from unbend.jobs.observer import NoObserver
from unbend.jobs.runner import JobRunner
from unbend.library import job_rows
from unbend.library.records import JobRecord
from unbend.library.requests import ShapeRequest, Upload
from unbend.library.shape_rows import put_mesh

FEW = Parameters(samples=40)
REQUEST = ShapeRequest("a mesh")
PATIENCE = 120.0


class Recorder(NoObserver):
    """Records the calls of the runner in order."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str]] = []

    def submitted(self, job: JobRecord) -> None:
        self.events.append(("submitted", job.id))

    def begun(self, job: JobRecord) -> None:
        self.events.append(("begun", job.id))

    def ended(self, job: JobRecord) -> None:
        self.events.append(("ended", job.id))


def fill(connection: Connection) -> None:
    """Exceed the size limit of the database: SQLite then rolls the whole transaction back, as on a full disk."""
    pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
    connection.exec_driver_sql(f"PRAGMA max_page_count = {pages + 4}")
    try:
        put_mesh(connection, "x" * 64, bytes(2**20))
    finally:
        connection.exec_driver_sql("PRAGMA max_page_count = 1000000")


def test_each_event_of_a_job_is_observed_once_although_its_transaction_was_rolled_back(tmp_path, caplog):
    observer = Recorder()
    started, released = threading.Event(), threading.Event()

    def occupy(_: Connection) -> None:
        started.set()
        released.wait(PATIENCE)

    async def story(library: Library) -> list[str]:
        runner = JobRunner(library, workers=1, observer=observer)
        await runner.start()
        async with asyncio.timeout(PATIENCE):
            first = asyncio.wrap_future(library.store.submit(occupy))
            await asyncio.to_thread(started.wait, PATIENCE)  # then the following changes share a transaction
            sent = [
                asyncio.create_task(runner.submit_shape(Upload(small_mesh(number), "ply", FEW), REQUEST))
                for number in range(3)
            ]
            await asyncio.sleep(0)  # each task submits its change
            full = asyncio.wrap_future(library.store.submit(fill))
            released.set()
            await first
            with pytest.raises(StoreFullError):
                await full
            jobs = [job.id for job in await asyncio.gather(*sent)]
            for job_id in jobs:
                await runner.wait(job_id, PATIENCE)
            await runner.stop()
        return jobs

    with Library(str(tmp_path / "library.db")) as library:
        jobs = asyncio.run(story(library))
    # The changes of the jobs had run in the transaction that was rolled back.
    assert any("rolled back" in record.msg and record.args[0] > len(jobs) for record in caplog.records)
    assert {job_id for _, job_id in observer.events} == set(jobs)  # no job that was rolled back
    for job_id in jobs:
        assert [event for event, of in observer.events if of == job_id] == ["submitted", "begun", "ended"]


def test_a_job_that_is_claimed_while_the_server_stops_is_requeued_without_an_attempt(tmp_path, monkeypatch):
    claimed: list[JobRecord | None] = []
    claim = job_rows.claim

    def recorded_claim(connection: Connection, ticket: int | None = None) -> JobRecord | None:
        claimed.append(claim(connection, ticket))
        return claimed[-1]

    monkeypatch.setattr(job_rows, "claim", recorded_claim)

    async def story(library: Library, job_id: str) -> JobRecord:
        runner = JobRunner(library, workers=1, limits=JobLimits(drain_seconds=0.0))
        async with asyncio.timeout(PATIENCE):
            await runner.start()
            with closing(sqlite3.connect(tmp_path / "library.db", isolation_level=None)) as other:
                other.execute("BEGIN IMMEDIATE")  # the first claim of the runner waits for this lock
                await asyncio.sleep(0.3)
                stopping = asyncio.create_task(runner.stop())
                await asyncio.sleep(0.1)
                assert claimed == []
                other.execute("ROLLBACK")
                await stopping
        with library.store.read() as connection:
            return job_rows.get_job(connection, job_id)

    with Library(str(tmp_path / "library.db")) as library:
        data = small_mesh(0)
        key = Upload(data, "ply", FEW).key
        with library.store.write() as connection:
            put_mesh(connection, key.sha256, data)
            job = job_rows.enqueue(connection, job_id=job_rows.new_id(), key=key, file_type="ply", request=REQUEST)
        left = asyncio.run(story(library, job.id))
    assert [job and job.id for job in claimed] == [left.id]
    assert (left.state, left.attempts, left.restarts) == ("queued", 0, 0)
