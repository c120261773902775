"""A worker process of one engine: `python -m benchmarks.cluster.worker ENGINE URL SLOTS NAME POLL QUICK`."""

from __future__ import annotations

import sys

from benchmarks.cluster import by_dbos, by_procrastinate
from benchmarks.cluster.runs import Setting

if __name__ == "__main__":
    engine, url, slots, name, poll, quick = sys.argv[1:]
    work = {"Procrastinate": by_procrastinate.work, "DBOS": by_dbos.work}[engine]
    work(Setting(engine, url, int(slots), name, float(poll), quick == "1"))
