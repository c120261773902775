"""A watchdog that measures how long a server delays a probe while it handles other requests."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.support.server import Server

_ROOT = Path(__file__).parents[2]

_PROBE = """
import http.client, sys, time
from urllib.parse import urlsplit

from tests.support.server import cpu_seconds

address = urlsplit(sys.argv[1])
server = int(sys.argv[2])
connection = http.client.HTTPConnection(address.hostname, address.port, timeout=300)
while True:
    begun, used = time.monotonic(), cpu_seconds(server)
    connection.request("GET", "/v1/livez")
    status = connection.getresponse()
    status.read()
    took, computed = time.monotonic() - begun, cpu_seconds(server) - used
    print(begun, took, computed, status.status, flush=True)
    time.sleep(0.01)
"""


@dataclass
class Stalls:
    """The measurements of the watchdog: times of the probes in seconds, and numbers of probes.

    `longest` is the longest time of a probe. `longest_computing` counts only the CPU time that the server used while
    the probe waited, so that it does not depend on what else runs on the machine.
    """

    longest: float = 0.0
    longest_computing: float = 0.0
    answered: int = 0
    failed: int = 0
    seen: list[tuple[float, float]] = field(default_factory=list)

    def longest_between(self, begin: float, end: float) -> float:
        """Return the longest time of the probes that were active in an interval of `time.monotonic()`."""
        return max((took for begun, took in self.seen if begun < end and begun + took > begin), default=0.0)


@contextmanager
def watchdog(server: Server) -> Iterator[Stalls]:
    """Request `/v1/livez` up to 100 times a second from another process; the results are complete after the block."""
    stalls = Stalls()
    command = [sys.executable, "-c", _PROBE, server.url, str(server.process.pid)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=_ROOT) as probe:
        assert probe.stdout is not None
        probe.stdout.readline()  # the first probe includes the time to connect
        try:
            yield stalls
            time.sleep(0.3)  # so that a stall at the end is measured completely
        finally:
            time.sleep(0.1)
            probe.terminate()
            for line in probe.stdout.read().splitlines():
                if len(measured := line.split()) < 4:
                    continue  # the probe ended while it wrote this line
                begun, took, computed = map(float, measured[:3])
                stalls.seen.append((begun, took))
                stalls.longest = max(stalls.longest, took)
                stalls.longest_computing = max(stalls.longest_computing, min(took, computed))
                stalls.answered += 1
                stalls.failed += measured[3] != "200"
