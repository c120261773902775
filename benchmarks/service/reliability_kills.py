"""Kills workers and servers repeatedly, and reports faults."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from benchmarks.common import table
from tests.support.crashes import Crash, Crashes
from tests.support.kills import MOMENTS, Kill, WorkerKiller
from tests.support.server import Server
from unbend.progress import STAGES

WORKERS: Final = 2
SHARES: Final = {"computing": 0.6, "sending": 0.15, "taking": 0.15, "idle": 0.1}
EARLY: Final = 5
"""One in this many servers is killed before its workers are ready."""

NAMES: Final = {
    "computing": "while it computes a job",
    "sending": "while it sends a result to a stopped server",
    "taking": "within 4 ms of receiving a job",
    "idle": "while idle",
}


@dataclass(frozen=True)
class Report:
    """A section of the page, and the faults found."""

    text: str
    faults: Sequence[str]


def progress(message: str) -> None:
    print(message, file=sys.stderr, flush=True)


def kill_workers(count: int, seed: int) -> Report:
    """Kill a worker `count` times, while jobs are running and queued."""
    random = np.random.default_rng(seed)
    places = np.searchsorted(np.cumsum([SHARES[moment] for moment in MOMENTS]), (np.arange(count) + 0.5) / count)
    moments = random.permutation([MOMENTS[place] for place in places])
    kills: list[Kill] = []
    with TemporaryDirectory() as folder, Server(Path(folder), workers=WORKERS) as server, server.http() as http:
        killer = WorkerKiller(server, http, random)
        for moment in moments:
            kills.append(killer.kill(str(moment)))
            progress(f"workers: {len(kills)} of {count}, {kills[-1]}")
    faults = [fault for kill in kills for fault in kill.faults]
    return Report(_of_workers(kills, seed, len(faults)), faults)


def _of_workers(kills: Sequence[Kill], seed: int, faults: int) -> str:
    rows = []
    for moment in MOMENTS:
        some = [kill for kill in kills if kill.moment == moment]
        if some:
            longest = f"{max(kill.seconds for kill in some):.1f}"
            jobs, hit = sum(kill.jobs for kill in some), sum(kill.hit for kill in some)
            rows.append([NAMES[moment], len(some), jobs, hit, jobs - hit, longest])
    header = [
        "moment of the kill",
        "kills",
        "jobs",
        "started twice",
        "started once",
        "longest time to the end of all jobs, s",
    ]
    stages = Counter(kill.stage for kill in kills if kill.hit)
    at = ", ".join(f"{stage} {stages[stage]}" for stage in STAGES if stages[stage])
    seen = sum(kill.in_a_pipe for kill in kills)
    return f"""\
The benchmark killed (SIGKILL) one of {WORKERS} workers of a running server {len(kills)} times (seed {seed}), while several uploads and queries were running or queued. A job that loses its process is started once more. Every other job must start once, and all jobs must succeed.

{table(header, rows)}

Last reported stages of the jobs that were started twice: {at}; no stage in {stages[None]} cases. In {seen} cases the worker was waiting to write to a full pipe. Faults (jobs that did not succeed, files that differ from the upload, more than one job started twice, or a job started twice although its worker was idle): {faults}."""  # noqa: E501


def kill_servers(count: int, seed: int) -> Report:
    """Kill a server under load `count` times, on one library."""
    with TemporaryDirectory() as folder:
        crashes = Crashes(Path(folder), seed)
        found: list[Crash] = []
        for number in range(count):
            found.append(crashes.crash(early=number % EARLY == EARLY - 1))
            progress(f"server: {number + 1} of {count}, {found[-1]}, faults: {len(crashes.faults)}")
        crashes.finish()
    return Report(_of_servers(crashes, found, seed), crashes.faults)


def _of_servers(crashes: Crashes, found: Sequence[Crash], seed: int) -> str:
    callers = crashes.callers
    states = Counter(job["state"] for caller in callers for job in caller.ended.values())
    rows = [
        ["servers killed", len(found)],
        ["of these before their workers were ready", sum(not crash.ready for crash in found)],
        ["acknowledged jobs (202, or answered directly)", sum(caller.acknowledged for caller in callers)],
        *([f"jobs that ended: {state}", states[state]] for state in sorted(states)),
        ["acknowledged shapes, present at the end byte for byte", sum(len(caller.kept) for caller in callers)],
        ["acknowledged removals, absent at the end", sum(len(caller.gone) for caller in callers)],
        ["longest start of a server, s", f"{max(crash.start_seconds for crash in found):.1f}"],
        [
            "longest life of a process after its server was killed, s",
            f"{max(crash.left_seconds for crash in found):.1f}",
        ],
        ["temporary files and folders left, at most", max(crash.left_folders for crash in found)],
        ["faults", len(crashes.faults)],
    ]
    return f"""\
The benchmark killed (SIGKILL) {len(found)} servers (seed {seed}) at random moments, one after another on one library file, while {len(callers)} clients uploaded, queried, changed, removed and cancelled. The next server had to have every acknowledged shape, byte for byte, and no shape whose removal was acknowledged. Ended jobs had to be unchanged in every field, and `PRAGMA integrity_check` and `foreign_key_check` had to find nothing. After each start, all recent acknowledgements and a sample of earlier ones were checked; at the end, everything was checked, and every acknowledged job had to have the correct final state.

{table(["", ""], rows)}"""  # noqa: E501
