"""Many jobs in a row, and what the processes hold meanwhile."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from benchmarks.common import table
from benchmarks.service.reliability_kills import WORKERS, Report, progress
from tests.support.footprint import Footprint, footprint
from tests.support.load import Caller, work
from tests.support.server import SAMPLES, Server

CALLERS: Final = 8
KEPT: Final = 25
"""Shapes that each caller leaves in the library."""

MIX: Final = {"upload": 40, "query": 42, "look": 4, "change": 4, "damaged": 8, "cancel": 2}
PARTS: Final = 10
BASE: Final = 1
"""The part, from 0, that the last one is compared with: by then caches are full."""

GROWTH: Final = 1.05
MORE_HANDLES: Final = 2
"""Connections to the store that may be open more or fewer."""

QUIET_SECONDS: Final = 2.0
MEGABYTE: Final = 2**20


@dataclass(frozen=True)
class Part:
    """What was held after a part of the jobs, when all had ended."""

    rate: float
    server: Footprint
    workers: dict[int, Footprint]


def work_on(jobs: int, shapes: int, seed: int) -> Report:
    """Have a server do `jobs` jobs with a library of constant size, and then add `shapes` shapes."""
    callers = [Caller(number, seed, mix=MIX, most_kept=KEPT) for number in range(CALLERS)]
    adders = [Caller(CALLERS + number, seed, mix={"upload": 1}) for number in range(CALLERS)]
    parts: list[Part] = []
    with TemporaryDirectory() as folder, Server(Path(folder), workers=WORKERS) as server:
        for number in range(PARTS):
            parts.append(_part(server, callers, jobs // PARTS))
            progress(f"memory: {number + 1} of {PARTS}, {parts[-1]}")
        for caller in callers:
            caller.check(server.url)
        size = server.library.stat().st_size
        _part(server, adders, CALLERS)  # so that these callers cost nothing more below
        before = _part(server, callers[:1], 20).server
        work(adders, server.url, shapes)
        after = _part(server, callers[:1], 20).server
        disk = (server.library.stat().st_size - size) / shapes
    faults = [fault for caller in [*callers, *adders] for fault in caller.faults]
    faults += _growth("the server", parts[BASE].server, parts[-1].server)
    for pid in parts[BASE].workers.keys() & parts[-1].workers.keys():
        faults += _growth("a worker", parts[BASE].workers[pid], parts[-1].workers[pid])
    text = _text(parts, callers, seed, len(faults))
    text += f"""

**One more shape.** {shapes} further shapes, with their jobs, enlarged the server's own memory by {(after.own - before.own) / shapes:.0f} bytes a shape, and
the library's file by {disk / 1024:.0f} kB a shape."""  # noqa: E501
    return Report(text, faults)


def _part(server: Server, callers: Sequence[Caller], jobs: int) -> Part:
    start = time.monotonic()
    work(callers, server.url, jobs)
    rate = jobs / (time.monotonic() - start)
    time.sleep(QUIET_SECONDS)
    return Part(rate, footprint(server.process.pid), {pid: footprint(pid) for pid in server.workers()})


def _growth(name: str, before: Footprint, after: Footprint) -> Iterator[str]:
    if after.own > GROWTH * before.own:
        yield f"{name} grew from {before.own / MEGABYTE:.1f} to {after.own / MEGABYTE:.1f} MB"
    if after.handles > before.handles + MORE_HANDLES:
        yield f"{name} has {after.handles} handles open instead of {before.handles}"
    if after.threads > before.threads:
        yield f"{name} has {after.threads} threads instead of {before.threads}"


def _text(parts: Sequence[Part], callers: Sequence[Caller], seed: int, faults: int) -> str:
    header = ["tenth", "jobs a second", "server: own MB", "resident MB", "handles", "threads"]
    header += ["workers: own MB", "handles", "threads"]
    rows = [[number + 1, f"{part.rate:.0f}", *_cells([part.server]), *_cells(part.workers.values(), resident=False)]
            for number, part in enumerate(parts)]  # fmt: skip
    base, last = parts[BASE].server, parts[-1].server
    replaced = len({pid for part in parts for pid in part.workers}) - WORKERS
    ended = [job["state"] for caller in callers for job in caller.ended.values()]
    return f"""\
{sum(caller.acknowledged for caller in callers):,} jobs (seed {seed}) on different small meshes, 60 to 252 vertices, `samples` {SAMPLES["samples"]}, from {CALLERS} clients: uploads and
queries, among them {ended.count("failed")} damaged files and {ended.count("cancelled")} cancelled jobs. The clients remove shapes so that the library stays at
some {CALLERS * KEPT}. The table shows resources after each tenth, when all its jobs have ended (own: not shared with another process):

{table(header, rows)}

The server's own memory after the last tenth is {last.own / base.own:.3f} times that after the second. Cancelling a running job replaces
its worker ({replaced} replacements were seen). Faults (more than {GROWTH - 1:.0%} of growth or more than {MORE_HANDLES} handles from the second tenth to the last, more
threads, wrong answers): {faults}."""  # noqa: E501


def _cells(of: Sequence[Footprint], *, resident: bool = True) -> list[str]:
    columns = [[f"{each.own / MEGABYTE:.1f}" for each in of]]
    if resident:
        columns.append([f"{each.resident / MEGABYTE:.1f}" for each in of])
    columns += [[str(each.handles) for each in of], [str(each.threads) for each in of]]
    return [" / ".join(column) for column in columns]
