"""Reliability of a real server: killed processes, full disks, stalls and memory growth.

    python -m benchmarks.service.reliability [workers] [server] [memory] [disk] [stalls]
        [--worker-kills N] [--server-kills N]

Writes the named sections of docs/reliability.md, or all: "workers", "server", "memory", "disk" and "stalls". Exits with
status 1 if there was a fault. "disk" mounts a small disk, which requires root.
"""

from __future__ import annotations

import argparse
import sys

from benchmarks.common import ROOT, write_section
from benchmarks.service.reliability_disk import fill_disk
from benchmarks.service.reliability_kills import Report, kill_servers, kill_workers
from benchmarks.service.reliability_memory import work_on
from benchmarks.service.reliability_stalls import stall

PAGE = ROOT / "docs" / "reliability.md"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="section", help="of the page; all by default")
    parser.add_argument("--worker-kills", type=int, default=100)
    parser.add_argument("--server-kills", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=10_000)
    parser.add_argument("--shapes", type=int, default=1000, help="shapes added to measure memory and disk of each")
    parser.add_argument("--disk-seconds", type=float, default=300.0, help="how long uploaders fill the disk")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    sections = {
        "workers": lambda: kill_workers(asked.worker_kills, asked.seed),
        "server": lambda: kill_servers(asked.server_kills, asked.seed),
        "memory": lambda: work_on(asked.jobs, asked.shapes, asked.seed),
        "disk": lambda: fill_disk(asked.disk_seconds, asked.seed),
        "stalls": lambda: stall(asked.seed),
    }
    if unknown := set(asked.sections) - set(sections):
        parser.error(f"no section {', '.join(sorted(unknown))}")
    if not PAGE.exists():
        PAGE.write_text("# Reliability\n")
    reports = {name: sections[name]() for name in sections if not asked.sections or name in asked.sections}
    for name, report in reports.items():
        write_section(PAGE, name, report.text)
    sys.exit(_print_faults(reports))


def _print_faults(reports: dict[str, Report]) -> int:
    """Print all faults; return the exit status."""
    for name, report in reports.items():
        for fault in report.faults:
            print(f"{name}: {fault}", file=sys.stderr)
    return int(any(report.faults for report in reports.values()))


if __name__ == "__main__":
    main()
