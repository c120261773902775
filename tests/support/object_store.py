"""Object stores for tests: a folder, and the server of moto, which answers like S3 but keeps objects in memory.

moto is a mock of S3. Requests travel to it over loopback as they do to S3, but it shares none of S3's code.
"""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import httpx

_START_SECONDS = 60.0
KEYS = {"AWS_ACCESS_KEY_ID": "someone", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_REGION": "us-east-1"}


@dataclass(frozen=True)
class MockS3:
    """A running server of moto."""

    address: str
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    @property
    def environment(self) -> Mapping[str, str]:
        """The variables by which obstore finds the server."""
        return {"AWS_ENDPOINT": self.address, "AWS_ALLOW_HTTP": "true", **KEYS}

    def new(self) -> str:
        """Return the address of a prefix in a new bucket."""
        bucket = f"bucket-{next(self._numbers)}"
        self._call("PUT", f"/{bucket}")
        return f"s3://{bucket}/meshes/of/unbend"

    def refuse(self) -> None:
        """Refuse the credentials of all callers."""
        self._call("POST", "/moto-api/reset-auth", "0")

    def accept(self) -> None:
        """Accept all callers again."""
        self._call("POST", "/moto-api/reset-auth", "1000000000")

    def _call(self, method: str, path: str, content: str = "") -> None:
        with httpx.Client(trust_env=False) as http:
            http.request(method, self.address + path, content=content).raise_for_status()


@contextmanager
def running_mock_s3() -> Iterator[MockS3]:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, "PYTHONWARNINGS": "ignore"}
    )
    try:
        address, end = f"http://127.0.0.1:{port}", time.monotonic() + _START_SECONDS
        while not _answers(address):
            if process.poll() is not None or time.monotonic() > end:
                raise RuntimeError("the server of moto did not start")
            time.sleep(0.05)
        yield MockS3(address)
    finally:
        process.kill()  # it has nothing to save
        process.wait(10)


def _answers(address: str) -> bool:
    try:
        return httpx.get(f"{address}/moto-api/", trust_env=False).is_success
    except httpx.TransportError:
        return False
