"""The jobs of the benchmark on DBOS."""

from __future__ import annotations

import asyncio
import signal
import threading
import time
from typing import Any

from dbos import DBOS, DBOSClient, DBOSConfig, WorkflowHandle
from psycopg_pool import ConnectionPool
from sqlalchemy import Connection, create_engine

from benchmarks.cluster.runs import ADD, BEGIN, END, NAME, SEE, TELL, Setting

VERSION = "1"


class Dbos:
    """The submitting side."""

    name = "DBOS"

    def __init__(self, url: str, poll: float) -> None:
        self._url = url
        self._poll = poll
        self._engine = create_engine(url.replace("postgresql:", "postgresql+psycopg:"))
        self._client: DBOSClient | None = None

    def install(self) -> None:
        """Create the engine's tables."""
        DBOS(config=_config(self._url, "installer"))
        DBOS.launch()
        DBOS.destroy(destroy_registry=True)

    @property
    def client(self) -> DBOSClient:
        """The client, which connects at its first use."""
        if self._client is None:
            self._client = DBOSClient(system_database_url=self._url, application_name="benchmark")
        return self._client

    def submit(self, connection: Connection, seconds: float, priority: int = 0) -> int:
        """Add a row of `runs` and its job in the caller's transaction; return the row's id."""
        run_id: int = connection.exec_driver_sql(ADD).scalar_one()
        name = "wait" if seconds else "run"
        handle: WorkflowHandle[None] = self.client.enqueue_in_transaction(
            connection, {"workflow_name": name, "queue_name": "jobs", "priority": 10 - priority}, run_id, seconds
        )
        connection.exec_driver_sql(NAME, (handle.workflow_id, run_id))
        return run_id

    def cancel(self, run_id: int) -> None:
        """Cancel a job, running or not."""
        with self._engine.begin() as connection:
            found = connection.exec_driver_sql("SELECT engine_id FROM runs WHERE id = %s", (run_id,)).scalar_one()
        self.client.cancel_workflow(found)

    def clear(self) -> None:
        """Delete all jobs; no worker may run."""
        with self._engine.begin() as connection:
            connection.exec_driver_sql("TRUNCATE dbos.workflow_status CASCADE")

    def close(self) -> None:
        """Close all connections."""
        if self._client:
            self._client.destroy()
        self._engine.dispose()


def _config(url: str, name: str) -> DBOSConfig:
    return {
        "name": "benchmark",
        "system_database_url": url,
        "executor_id": name,
        "application_version": VERSION,
        "log_level": "ERROR",
    }


def work(setting: Setting) -> None:
    """Run jobs until SIGTERM."""
    stopped = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    with ConnectionPool(setting.url, min_size=1, max_size=setting.slots, open=True) as pool:
        DBOS(config=_config(setting.url, setting.name))
        _define(pool)
        DBOS.launch()
        DBOS.register_queue(
            "jobs", worker_concurrency=setting.slots, polling_interval_sec=setting.poll, on_conflict="always_update"
        )
        time.sleep(3)  # the queue's thread starts within a second, and looks first after its interval
        print("ready", flush=True)
        stopped.wait()
        DBOS.destroy(workflow_completion_timeout_sec=1)


def _define(pool: ConnectionPool[Any]) -> None:
    def write(*statements: tuple[str, tuple[object, ...]]) -> None:
        with pool.connection() as connection:
            for statement, values in statements:
                connection.execute(statement.encode(), values)

    @DBOS.workflow(name="run")
    def run(run_id: int, seconds: float) -> None:  # noqa: ARG001  the submitting side gives both
        write((END, ([time.time()], time.time(), run_id)), (TELL, (run_id,)))

    @DBOS.step(preemptible=True)
    async def sleep(run_id: int, seconds: float) -> None:
        try:
            await asyncio.sleep(seconds)
        except asyncio.CancelledError:
            write((SEE, (time.time(), run_id)))
            raise

    @DBOS.workflow(name="wait")
    async def wait(run_id: int, seconds: float) -> None:
        write((BEGIN, (time.time(), run_id)))
        await sleep(run_id, seconds)
        write((END, ([], time.time(), run_id)), (TELL, (run_id,)))
