"""Processes killed at chosen moments, and many jobs: small numbers of what benchmarks/service/reliability.py does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.crashes import Crashes
from tests.support.footprint import footprint
from tests.support.kills import MOMENTS, PATIENCE, WorkerKiller
from tests.support.load import Caller, work
from tests.support.server import Server

MORE_HANDLES = 2
"""Connections to the store that may be open more or fewer."""
MORE_THREADS = 3
"""Of the event loop's, which come as they are needed, and the one that empties the store's log."""


@pytest.fixture(scope="module")
def called(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("called")) as running:
        yield running


@pytest.fixture(scope="module")
def killer(called):
    with called.http() as http:
        yield WorkerKiller(called, http, np.random.default_rng(2))


def test_many_jobs_leave_no_handles_and_no_threads(called):
    callers = [Caller(number, 1, most_kept=5) for number in range(4)]
    work(callers, called.url, 100)
    before = footprint(called.process.pid)
    work(callers, called.url, 200)
    after = footprint(called.process.pid)
    for caller in callers:
        caller.check(called.url, everything=True)
    assert [fault for caller in callers for fault in caller.faults] == []
    assert after.handles <= before.handles + MORE_HANDLES
    assert after.threads <= before.threads + MORE_THREADS


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_worker_killed_at_any_moment_costs_one_job_an_attempt_at_most(killer, moment):
    kill = killer.kill(moment)
    assert kill.faults == ()
    assert kill.hit <= 1
    assert kill.seconds < PATIENCE


def test_what_was_acknowledged_outlives_servers_killed_under_load(tmp_path):
    crashes = Crashes(tmp_path, seed=3, callers=3)
    found = [crashes.crash(early=early) for early in (False, True, False)]
    crashes.finish()
    assert crashes.faults == []
    assert sum(crash.acknowledged for crash in found) > 5
    assert all(caller.ended for caller in crashes.callers)
