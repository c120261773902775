"""A watchdog that measures how long a server delays a probe while it handles other requests."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

_PROBE = """
import http.client, sys, time
from urllib.parse import urlsplit

address = urlsplit(sys.argv[1])
connection = http.client.HTTPConnection(address.hostname, address.port, timeout=300)
while True:
    begun = time.monotonic()
    connection.request("GET", "/v1/livez")
    status = connection.getresponse()
    status.read()
    print(begun, time.monotonic() - begun, status.status, flush=True)
    time.sleep(0.01)
"""


@dataclass
class Stalls:
    """The measurements of the watchdog: the longest time of a probe in seconds, and numbers of probes."""

    longest: float = 0.0
    answered: int = 0
    failed: int = 0
    seen: list[tuple[float, float]] = field(default_factory=list)

    def longest_between(self, begin: float, end: float) -> float:
        """Return the longest time of the probes that were active in an interval of `time.monotonic()`."""
        return max((took for begun, took in self.seen if begun < end and begun + took > begin), default=0.0)


@contextmanager
def watchdog(url: str) -> Iterator[Stalls]:
    """Request `/v1/livez` a hundred times a second from another process; the results are complete after the block."""
    stalls = Stalls()
    with subprocess.Popen([sys.executable, "-c", _PROBE, url], stdout=subprocess.PIPE, text=True) as probe:
        assert probe.stdout is not None
        probe.stdout.readline()  # the first includes the connection
        try:
            yield stalls
            time.sleep(0.3)  # so that a stall at the end is measured completely
        finally:
            time.sleep(0.1)
            probe.terminate()
            for line in probe.stdout.read().splitlines():
                begun, took, status = line.split()
                stalls.seen.append((float(begun), float(took)))
                stalls.longest = max(stalls.longest, float(took))
                stalls.answered += 1
                stalls.failed += status != "200"
