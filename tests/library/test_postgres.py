"""A library in PostgreSQL that several processes use: no two writers break what one alone would keep."""

from __future__ import annotations

import asyncio
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import Connection, text

from tests.support.store import PARAMETERS, add, insert
from unbend import Library
from unbend.errors import ExtraMissingError, ParameterError, QuotaError, StoreError, StoreUnavailableError, UnbendError
from unbend.jobs.limits import JobLimits
from unbend.jobs.runner import JobRunner
from unbend.library import job_rows, tickets
from unbend.library.job_rows import Sender
from unbend.library.jobs import ANONYMOUS, NewJob, QueueLimits
from unbend.library.request_rates import SharedRateLimit
from unbend.library.requests import QueryRequest, Upload

DATABASES = ("postgresql",)
LIMITS = QueueLimits(10**6)
UPLOAD = Upload(b"a query", "off", PARAMETERS)


@pytest.fixture
def other(url):
    """The same library, opened a second time as another process would."""
    with Library(url, migrate=False) as opened:
        yield opened


def together(*calls):
    """Run functions in threads at the same time; return their results or errors."""
    barrier = threading.Barrier(len(calls))

    def run(call):
        barrier.wait()
        try:
            return call()
        except UnbendError as error:
            return error

    with ThreadPoolExecutor(len(calls)) as threads:
        return list(threads.map(run, calls))


def submit(library: Library, sender: Sender = ANONYMOUS, limits: QueueLimits = LIMITS):
    return library.jobs.submit_query(UPLOAD, QueryRequest(), sender, limits).result()


def ticket_count(library: Library) -> int:
    with library.store.read() as connection:
        return connection.scalar(text("SELECT count(*) FROM procrastinate_jobs WHERE status = 'todo'"))


def test_the_same_file_added_by_many_at_once_is_one_shape(library, other):
    def add_to(which, number):
        return lambda: which.store.change(lambda connection: insert(connection, b"same", f"by {number}"))

    found = together(*(add_to((library, other)[number % 2], number) for number in range(8)))
    assert len({shape.id for shape in found}) == 1
    assert len(library) == 1


def test_shapes_appear_in_the_order_of_their_places_whoever_adds_them(library, other):
    seen: list[int] = []
    stop = threading.Event()

    def watch():
        while not stop.is_set():
            with library.store.read() as connection:
                seqs = list(connection.scalars(text("SELECT seq FROM shapes ORDER BY seq")))
            assert seqs[: len(seen)] == seen  # none appears before one that was seen
            seen[:] = seqs

    with ThreadPoolExecutor(1) as threads:
        watching = threads.submit(watch)
        together(
            *(
                lambda which=which, start=start: [
                    add(which, b"%d" % number, "a") for number in range(start, start + 20)
                ]
                for start, which in ((0, library), (20, other), (40, other))
            )
        )
        stop.set()
        watching.result()
    assert len(library) == 60


def test_a_request_that_arrives_at_two_servers_at_once_is_one_job(library, other):
    for number in range(10):
        sender = Sender(None, f"{number:064}", "f" * 64)
        found = together(*(lambda which=which, sender=sender: submit(which, sender) for which in (library, other) * 2))
        assert len({(each.job if isinstance(each, NewJob) else each).id for each in found}) == 1
        assert sum(isinstance(each, NewJob) for each in found) == 1


def test_a_key_gets_no_more_jobs_by_asking_two_servers_at_once(library, other):
    limits = QueueLimits(10**6, owned=3)
    found = together(*(lambda which=which: submit(which, Sender("a"), limits) for which in (library, other) * 4))
    assert sum(isinstance(each, NewJob) for each in found) == 3
    assert sum(isinstance(each, QuotaError) for each in found) == 5


def test_no_two_workers_claim_one_job(library, other):
    for _ in range(20):
        submit(library)
    claimed = together(
        *(lambda which=which: [which.jobs.claim(1).result() for _ in range(5)] for which in (library, other) * 2)
    )
    ids = [job.id for jobs in claimed for job in jobs if job]
    assert len(ids) == len(set(ids)) == 20


def test_a_claim_whose_answer_was_lost_is_answered_again_and_takes_no_second_job(library):
    for _ in range(2):
        submit(library)
    claim = library.jobs.claims(7)
    assert claim().result() == claim().result()


def test_only_one_of_several_ends_of_a_job_counts(library, other):
    job = submit(library).job
    assert library.jobs.claim(5).result().id == job.id
    running = asyncio.run(library.jobs.get(job.id))
    error = {"code": "cancelled", "message": "", "advice": ""}
    ends = together(
        lambda: library.jobs.cancel(job.id, error, None).result(),
        lambda: other.jobs.fail(running, error, None).result(),
    )
    assert sum(each is not None for each in ends) == 1


def test_a_worker_that_was_cut_off_cannot_end_a_job_that_another_has(library, other):
    submit(library)
    cut_off = library.jobs.claim(1).result()
    assert other.jobs.recover_ticket(1, 10, {}).result() is None
    again = other.jobs.claim(2).result()
    assert (again.id, again.attempts, again.restarts) == (cut_off.id, 2, 1)
    error = {"code": "worker_lost", "message": "", "advice": ""}
    assert library.jobs.fail(cut_off, error, None).result() is None
    library.jobs.requeue(cut_off, "stopped").result()
    assert asyncio.run(other.jobs.get(cut_off.id)).state == "running"
    assert other.jobs.fail(again, error, None).result().state == "failed"


def test_a_job_whose_workers_die_again_and_again_fails(library):
    submit(library)
    error = {"code": "worker_lost", "message": "the worker died", "advice": ""}
    for number in range(3):
        assert library.jobs.claim(number).result().restarts == number
        ended = library.jobs.recover_ticket(number, 2, error).result()
        assert (ended is not None) == (number == 2)
    assert ended.state == "failed"
    assert ended.error == error


def test_each_queued_job_has_a_ticket_and_lost_tickets_are_noticed(library):
    for _ in range(3):
        submit(library)
    assert ticket_count(library) == 3
    job = library.jobs.claim(7).result()
    library.jobs.requeue(job, "stopped").result()
    assert ticket_count(library) == 4  # one more than needed does no harm
    library.store.change(lambda connection: connection.execute(text("DELETE FROM procrastinate_jobs")).close())
    lost, missing = asyncio.run(library.jobs.tickets(20))
    assert (lost, missing) == ([], 3)
    library.jobs.issue_tickets(missing, 20).result()
    assert ticket_count(library) == 3
    library.jobs.claim(8).result()
    lost, _ = asyncio.run(library.jobs.tickets(20))
    assert lost == [8]  # no worker has this ticket


def test_a_rolled_back_submission_leaves_no_ticket(library):
    def spoil(connection: Connection) -> None:
        job_rows.enqueue(
            connection, job_id="spoilt", key=UPLOAD.key, file_type="off", request=QueryRequest(), sender=ANONYMOUS
        )

    with pytest.raises(Exception, match="meshes"):  # the file is missing
        library.store.change(spoil)
    assert ticket_count(library) == 0


def test_a_change_runs_again_if_its_connection_is_lost_before_or_at_the_commit(library, postgres):
    runs = []

    def change(connection: Connection) -> str:
        runs.append(connection.scalar(text("SELECT pg_backend_pid()")))
        shape = insert(connection, b"once", "once")
        if len(runs) == 1:
            postgres.execute(f"SELECT pg_terminate_backend({runs[0]}, 5000)")
        return shape.id

    shape_id = library.store.change(change)
    assert len(runs) == 2
    assert library.get(shape_id).name == "once"


def test_a_submission_that_ran_twice_adds_one_job(library, monkeypatch):
    enqueue, lost = job_rows.enqueue, []

    def enqueue_and_lose_the_answer(connection, **values):
        job = enqueue(connection, **values)
        if not lost:
            lost.append(job)
            connection.commit()
            connection.connection.driver_connection.close()  # as if the answer to the commit never came
            connection.execute(text("SELECT 1"))
        return job

    monkeypatch.setattr(job_rows, "enqueue", enqueue_and_lose_the_answer)
    job = submit(library).job
    assert job.id == lost[0].id
    assert asyncio.run(library.jobs.count_queued()) == 1


def test_reads_go_on_after_the_server_ended_every_connection(library, postgres):
    shape = add(library, b"a", "a")
    for _ in range(2):
        postgres.disconnect(library.url)
        assert library.get(shape.id).name == "a"
        assert add(library, b"b", "b").name == "b"


def test_a_reader_sees_one_state_and_cannot_write(library):
    add(library, b"a", "a")
    count = text("SELECT count(*) FROM shapes")
    with library.store.read() as connection:
        assert connection.scalar(count) == 1
        add(library, b"b", "b")
        assert connection.scalar(count) == 1
        with pytest.raises(Exception, match="read-only"):
            connection.execute(text("DELETE FROM shapes"))


def test_an_unreachable_database_is_a_typed_error_within_seconds(library, postgres):
    begun = time.monotonic()
    with pytest.raises(StoreError, match="cannot be opened"):
        Library("postgresql+psycopg://me:secret@127.0.0.1:1/shapes")
    url = postgres.new()
    with Library(url) as gone:
        postgres.drop(url)
        with pytest.raises(StoreUnavailableError) as raised:
            len(gone)
        assert raised.value.retry_after >= 1
    assert time.monotonic() - begun < 20


@pytest.mark.parametrize("url_", ["mysql://host/shapes", "postgresql://host:port/shapes", "oracle://x"])
def test_a_url_of_an_unknown_database_is_refused(url_):
    with pytest.raises(ParameterError, match="neither a path nor the URL of a known database"):
        Library(url_)


def test_without_its_packages_a_library_in_postgresql_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "psycopg", None)
    with pytest.raises(ExtraMissingError, match="cluster"):
        Library("postgresql://host/shapes")


def test_the_rate_of_a_caller_is_limited_for_all_servers_together(library, other):
    limits = [SharedRateLimit(each.store, 6) for each in (library, other)]
    taken = [limits[number % 2].take("a") for number in range(8)]
    assert taken[:6] == [0] * 6
    assert all(1 <= wait <= 10 for wait in taken[6:])
    assert limits[0].take("b") == 0


def test_many_migrations_at_once_are_one(postgres):
    url = postgres.new()
    found = together(*(lambda: Library(url).close() for _ in range(4)))
    assert found == [None] * 4
    with Library(url) as library:
        assert len(library) == 0


def test_a_server_without_workers_follows_a_job_that_another_process_runs(library, other):
    async def story() -> None:
        server = JobRunner(library, workers=0, limits=JobLimits(drain_seconds=0))
        await server.start()
        async with asyncio.timeout(60):
            job = await server.submit_query(UPLOAD, QueryRequest())
            waiting = asyncio.create_task(server.wait(job.id, 50))
            await asyncio.sleep(0.3)
            assert (await asyncio.to_thread(other.jobs.claim(1).result)).id == job.id
            error = {"code": "mesh", "message": "", "advice": ""}
            await asyncio.to_thread(other.jobs.fail(await server.status(job.id), error, None).result)
            assert (await waiting).state == "failed"
        await server.stop()

    asyncio.run(story())


def test_tickets_of_dead_workers_without_a_job_are_deleted(library):
    submit(library)
    library.store.change(
        lambda connection: connection.execute(text("UPDATE procrastinate_jobs SET status = 'doing'")).close()
    )
    lost, missing = asyncio.run(library.jobs.tickets(20))
    assert (lost, missing) == ([], 1)
    library.jobs.issue_tickets(1, 20).result()
    assert asyncio.run(library.jobs.tickets(20)) == ([], 0)
    with library.store.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM procrastinate_jobs")) == 1
        assert tickets.count_missing(connection, 20) == 0
