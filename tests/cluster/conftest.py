"""Two servers without workers and one worker, which share a library in PostgreSQL."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from tests.support.postgres import Postgres
from tests.support.server import Server, Worker


@dataclass(frozen=True)
class Cluster:
    """Running processes that share a library."""

    library: str
    servers: tuple[Server, Server]
    worker: Worker
    first: httpx.Client
    """A client of the first server."""
    second: httpx.Client


@contextlib.contextmanager
def running_cluster(folder: Path, library: str, **settings: object) -> Iterator[Cluster]:
    """Start two servers and a worker with two processes, at the same time."""
    with contextlib.ExitStack() as stack, ThreadPoolExecutor() as threads:
        servers = [
            threads.submit(Server, folder / f"server-{number}", library=library, workers=0, **settings)
            for number in range(2)
        ]
        worker = threads.submit(Worker, folder / "worker", library=library, workers=2, **settings)
        one, other, works = (stack.enter_context(each.result()) for each in (*servers, worker))
        clients = [stack.enter_context(each.http()) for each in (one, other)]
        yield Cluster(library, (one, other), works, *clients)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory, postgres: Postgres, empty_postgres_library: str):
    library = postgres.copy(empty_postgres_library)
    with running_cluster(tmp_path_factory.mktemp("cluster"), library, drain_seconds=0.5) as running:
        yield running
    postgres.drop(library)
