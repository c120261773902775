"""Workers and servers that are killed, again and again."""

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
"""Of so many servers one is killed before its workers are ready."""

NAMES: Final = {
    "computing": "at any time from its start to its end",
    "sending": "when its result was ready and the server stood still",
    "taking": "within 4 ms of being handed a job",
    "idle": "with nothing to do",
}


@dataclass(frozen=True)
class Report:
    """A section of the page, and what was not as it must be."""

    text: str
    faults: Sequence[str]


def progress(message: str) -> None:
    print(message, file=sys.stderr, flush=True)


def kill_workers(count: int, seed: int) -> Report:
    """Kill a worker `count` times, with jobs in hand and waiting beside."""
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
        "the worker was killed",
        "times",
        "jobs at hand",
        "begun twice",
        "begun once",
        "until all ended, s, at most",
    ]
    stages = Counter(kill.stage for kill in kills if kill.hit)
    at = ", ".join(f"{stage} {stages[stage]}" for stage in STAGES if stages[stage])
    seen = sum(kill.in_a_pipe for kill in kills)
    return f"""\
{len(kills)} times (seed {seed}) one of {WORKERS} workers of a running server was killed (SIGKILL) while several uploads and queries were running
and queued. A job that loses its process must begin once more, every other job only once, and all jobs must succeed.

{table(header, rows)}

Last stages that the jobs begun twice had reported: {at}; no stage in {stages[None]} cases. In {seen} cases the
worker was waiting for space in the pipe. Faults (jobs that did not succeed, files that differed from those sent, more
than one job begun twice, or any if the worker was idle): {faults}."""  # noqa: E501


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
        ["jobs acknowledged (202, or answered in place)", sum(caller.acknowledged for caller in callers)],
        *([f"jobs followed to their end: {state}", states[state]] for state in sorted(states)),
        ["shapes acknowledged, there at the end with their bytes", sum(len(caller.kept) for caller in callers)],
        ["shapes whose removal was acknowledged, gone", sum(len(caller.gone) for caller in callers)],
        ["seconds until a server answered, at most", f"{max(crash.start_seconds for crash in found):.1f}"],
        [
            "seconds that a process outlived its server, at most",
            f"{max(crash.left_seconds for crash in found):.1f}",
        ],
        ["folders for temporary files left, at most", max(crash.left_folders for crash in found)],
        ["faults", len(crashes.faults)],
    ]
    return f"""\
{len(found)} servers (seed {seed}), one after the other on one library file, were killed (SIGKILL) at a random moment
while {len(callers)} clients uploaded, queried, changed, removed and cancelled. The next server had to have every
acknowledged shape, byte for byte, and no shape whose removal was acknowledged. Ended jobs had to be the same in every
field, and `PRAGMA integrity_check` and `foreign_key_check` had to find nothing. After each start, the latest
acknowledgements and a sample of earlier ones were checked, and at the end all of them. By then every acknowledged job
had to have the result that its file requires.

{table(["", ""], rows)}"""
