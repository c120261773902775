"""Processes killed at chosen moments, and many jobs: a short version of benchmarks/service/reliability.py."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.crashes import Crashes, leftovers
from tests.support.footprint import footprint
from tests.support.kills import MOMENTS, PATIENCE, WorkerKiller
from tests.support.load import Caller, work
from tests.support.server import Server

MORE_HANDLES = 12
"""Allowed increase of file descriptors: each of the four callers may open one more connection to the store, and each
connection has three descriptors. 200 jobs of which one in ten leaks a descriptor open more."""
MORE_THREADS = 3
"""Allowed increase of threads: threads of the event loop's pool start on demand, as does the eraser of the log."""


@pytest.fixture(scope="module")
def busy_server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("busy")) as running:
        yield running


@pytest.fixture(scope="module")
def killer(busy_server):
    with busy_server.http() as http:
        yield WorkerKiller(busy_server, http, np.random.default_rng(2))


def test_many_jobs_leak_no_file_descriptors_or_threads(busy_server):
    callers = [Caller(number, 1, most_kept=5) for number in range(4)]
    work(callers, busy_server.url, 100)
    before = footprint(busy_server.process.pid)
    work(callers, busy_server.url, 200)
    after = footprint(busy_server.process.pid)
    for caller in callers:
        caller.check(busy_server.url, everything=True)
    assert [fault for caller in callers for fault in caller.faults] == []
    assert after.handles <= before.handles + MORE_HANDLES
    assert after.threads <= before.threads + MORE_THREADS


@pytest.mark.parametrize("moment", MOMENTS)
def test_killing_a_worker_repeats_at_most_one_job(killer, moment):
    kill = killer.kill(moment)
    assert kill.faults == ()
    assert kill.hit <= 1
    assert kill.seconds < PATIENCE


def test_acknowledged_jobs_survive_servers_killed_under_load(tmp_path):
    crashes = Crashes(tmp_path, seed=3, callers=3)
    found = [crashes.crash(early=early) for early in (False, True, False)]
    crashes.finish()
    assert crashes.faults == []
    assert sum(crash.acknowledged for crash in found) > 5
    assert all(caller.ended for caller in crashes.callers)


def test_empty_temporary_files_of_sqlite_are_not_leftovers(tmp_path):
    (tmp_path / "etilqs_0123456789abcdef").touch()
    assert leftovers(tmp_path) == []
    (tmp_path / "etilqs_fedcba9876543210").write_bytes(b"content")
    (tmp_path / "unbend-backup-1").mkdir()
    assert {path.name for path in leftovers(tmp_path)} == {"etilqs_fedcba9876543210", "unbend-backup-1"}
