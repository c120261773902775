"""The order of the queue: API keys take turns, and the reported positions are correct."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support.store import PARAMETERS, add
from unbend import Library
from unbend.errors import QueueFullError, QuotaError
from unbend.library import job_rows, shape_rows
from unbend.library.job_rows import Sender
from unbend.library.jobs import QueueLimits
from unbend.library.requests import FileRequest, QueryRequest, ShapeRequest, Upload


def send(connection, number: int, owner: str | None, data: bytes = b"") -> job_rows.JobRecord:
    data = data or b"%d" % number
    key = Upload(data, "off", PARAMETERS).key
    shape_rows.put_mesh(connection, key.sha256, data)
    request = ShapeRequest("a") if data == b"same" else QueryRequest()
    return job_rows.enqueue(
        connection, job_id=job_rows.new_id(), key=key, file_type="off", request=request, sender=Sender(owner)
    )


def test_many_jobs_of_one_key_do_not_delay_another_key(library):
    with library.store.write() as connection:
        for number in range(60):
            send(connection, number, "a")
        other = send(connection, 60, "b")
        assert job_rows.position(connection, other) == 1
        claimed = [job_rows.claim(connection) for _ in range(3)]
    assert [job.owner for job in claimed] == ["a", "b", "a"]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    owners=st.lists(st.sampled_from([None, "a", "b", "c"]), min_size=1, max_size=14),
    begun=st.integers(0, 6),
)
def test_the_position_of_a_job_is_the_number_of_jobs_that_start_before_it(tmp_path_factory, owners, begun):
    with (
        Library(str(tmp_path_factory.mktemp("turns") / "a.db")) as library,
        library.store.write() as connection,
    ):
        sent = [send(connection, number, owner).id for number, owner in enumerate(owners)]
        for _ in range(min(begun, len(sent) - 1)):
            job_rows.claim(connection)
        waiting = [job_rows.get_job(connection, one) for one in sent]
        places = {job.id: job_rows.position(connection, job) for job in waiting if job.state == "queued"}
        order = []
        while job := job_rows.claim(connection):
            order.append(job.id)
        assert places == {one: place for place, one in enumerate(order)}


def test_files_of_a_shape_count_as_jobs_of_their_key(library):
    shape, wanted = add(library, b"a", "a"), FileRequest("mesh", {"file_type": "ply"}, "ply", "a")
    library.jobs.submit_file(shape, wanted, Sender("a"), QueueLimits(2, owned=1)).result()
    with pytest.raises(QuotaError):
        library.jobs.submit_file(shape, wanted, Sender("a"), QueueLimits(2, owned=1)).result()
    library.jobs.submit_file(shape, wanted, Sender("b"), QueueLimits(2, owned=1)).result()
    with pytest.raises(QueueFullError):
        library.jobs.submit_file(shape, wanted, Sender("c"), QueueLimits(2, owned=1)).result()


def test_a_job_whose_known_shape_was_removed_keeps_its_attempts(library):
    shape = add(library, b"a", "a")
    key = Upload(b"a", "off", PARAMETERS).key
    with library.store.write() as connection:
        job = send(connection, 0, None, b"same")
        claimed = job_rows.claim(connection)
    library.shapes.remove(shape.id)
    assert claimed.id == job.id
    assert library.jobs.complete_known(claimed, key).result() is None
    with library.store.read() as connection:
        again = job_rows.get_job(connection, job.id)
    assert (again.state, again.attempts, again.restarts) == ("queued", 0, 0)


def test_an_upload_waits_while_an_equal_upload_is_computed(library):
    with library.store.write() as connection:
        first, second = (send(connection, number, owner, b"same") for number, owner in enumerate("ab"))
        other = send(connection, 2, "a")
        assert job_rows.claim(connection).id == first.id
        assert job_rows.claim(connection).id == other.id
        assert job_rows.claim(connection) is None
        job_rows.finish(connection, first.id, "failed")
        assert job_rows.claim(connection).id == second.id
