"""The history of jobs: it is listed in pages, has a limit, and does not slow the removal of shapes down."""

from __future__ import annotations

import time
from datetime import UTC, datetime, timedelta

import pytest

from tests.support.store import PARAMETERS, add
from unbend.errors import NotFoundError, ParameterError
from unbend.library import job_rows, shape_rows
from unbend.library.job_rows import JobFilter
from unbend.library.requests import QueryRequest, ShapeRequest, Upload


def answered(connection, count: int, answer: dict, label: str = "") -> None:
    """Store `count` ended queries with the same result."""
    for number in range(count):
        key = Upload(b"%d" % number, "off", PARAMETERS).key
        shape_rows.put_mesh(connection, key.sha256, b"%d" % number)
        job = job_rows.enqueue(connection, job_id=job_rows.new_id(), key=key, file_type="off", request=QueryRequest())
        job_rows.claim(connection)
        job_rows.finish(connection, job.id, "succeeded", result=answer)


def ranking(*shapes) -> dict:
    return {
        "measure": "moments", "known": True, "warnings": [],
        "classes": [{"label": "a", "distance": 0.5, "confidence": 0.5}],
        "shapes": [{"id": one.id, "name": one.name, "label": one.label, "distance": 0.1} for one in shapes],
    }  # fmt: skip


def listed(library, which: JobFilter | None = None, cursor: str | None = None, limit: int = 100):
    with library.store.read() as connection:
        return job_rows.list_jobs(connection, which or JobFilter(), cursor=cursor, limit=limit)


def test_pages_of_jobs_contain_each_job_once_without_results(library):
    shape = add(library, b"one", "one", "a")
    with library.store.write() as connection:
        answered(connection, 25, ranking(shape))
    seen, cursor = [], None
    while True:
        page = listed(library, cursor=cursor, limit=10)
        seen += page.items
        cursor = page.next_cursor
        if cursor is None:
            break
    assert [job.seq for job in seen] == sorted((job.seq for job in seen), reverse=True)
    assert len({job.id for job in seen}) == 25
    assert {job.result for job in seen} == {None}
    with pytest.raises(ParameterError, match="cursor"):
        listed(library, cursor="x")


def test_jobs_are_found_by_state_kind_and_shape(library):
    shape = add(library, b"one", "one", "a")
    with library.store.write() as connection:
        answered(connection, 2, ranking(shape))
        key = Upload(b"mesh", "off", PARAMETERS).key
        shape_rows.put_mesh(connection, key.sha256, b"mesh")
        upload = job_rows.enqueue(
            connection, job_id=job_rows.new_id(), key=key, file_type="off", request=ShapeRequest("a")
        )
        waiting = job_rows.enqueue(
            connection, job_id=job_rows.new_id(), key=key, file_type="off", request=QueryRequest()
        )
        job_rows.claim(connection)
        job_rows.finish(connection, upload.id, "succeeded", shape_id=shape.id)
    assert [job.id for job in listed(library, JobFilter(state="queued")).items] == [waiting.id]
    assert [job.id for job in listed(library, JobFilter(kind="shape")).items] == [upload.id]
    assert [job.id for job in listed(library, JobFilter(shape_id=shape.id)).items] == [upload.id]
    assert len(listed(library, JobFilter(kind="query", state="succeeded")).items) == 2


def test_queue_positions_count_all_queued_jobs(library):
    with library.store.write() as connection:
        ids = []
        for number in range(9):
            key = Upload(b"%d" % number, "off", PARAMETERS).key
            shape_rows.put_mesh(connection, key.sha256, b"%d" % number)
            request = ShapeRequest("a") if number % 3 else QueryRequest()
            ids.append(
                job_rows.enqueue(connection, job_id=job_rows.new_id(), key=key, file_type="off", request=request).id
            )
        page = job_rows.list_jobs(connection, JobFilter(kind="query"), cursor=None, limit=2)
        assert job_rows.positions(connection, page.items) == {ids[6]: 6, ids[3]: 3}


def test_deleting_old_jobs_keeps_the_newest_and_all_queued_ones(library):
    with library.store.write() as connection:
        answered(connection, 12, ranking())
        key = Upload(b"mesh", "off", PARAMETERS).key
        shape_rows.put_mesh(connection, key.sha256, b"mesh")
        waiting = job_rows.enqueue(
            connection, job_id=job_rows.new_id(), key=key, file_type="off", request=QueryRequest()
        )
    before = [job.id for job in listed(library).items]
    with library.store.write() as connection:
        assert job_rows.delete_ended(connection, keep=5) == 7
        assert job_rows.delete_ended(connection, keep=5) == 0
    assert [job.id for job in listed(library).items] == before[:6]
    assert before[0] == waiting.id
    with library.store.read() as connection, pytest.raises(NotFoundError, match="deleted"):
        job_rows.get_job(connection, before[-1])


def test_jobs_that_ended_before_a_time_are_deleted(library):
    with library.store.write() as connection:
        answered(connection, 3, ranking())
    between = datetime.now(UTC)
    with library.store.write() as connection:
        answered(connection, 2, ranking())
    with library.store.write() as connection:
        assert job_rows.delete_ended(connection, before=between - timedelta(days=1)) == 0
        assert job_rows.delete_ended(connection, before=between) == 3
    assert len(listed(library).items) == 2


def test_a_long_history_does_not_slow_the_removal_of_shapes_down(library):
    shapes = [add(library, b"%d" % number, str(number), "a") for number in range(12)]

    def removing(some) -> float:
        begun = time.perf_counter()
        for shape in some:
            library.remove(shape.id)
        return time.perf_counter() - begun

    without = removing(shapes[:5])
    with library.store.write() as connection:
        answered(connection, 2000, ranking(*shapes[5:]))
    assert removing(shapes[5:10]) < 10 * without + 0.5  # an earlier version took 30 ms more for each query
    job = listed(library, limit=1).items[0]
    with library.store.read() as connection:
        reported = job_rows.get_job(connection, job.id).result
    assert [match["id"] for match in reported["shapes"]] == [shape.id for shape in shapes[10:]]
