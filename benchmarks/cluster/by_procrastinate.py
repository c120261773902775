"""The jobs of the benchmark on Procrastinate."""

from __future__ import annotations

import asyncio
import contextlib
import time
from datetime import UTC, datetime
from typing import Any

from procrastinate import App, PsycopgConnector, SyncPsycopgConnector
from psycopg_pool import AsyncConnectionPool
from sqlalchemy import Connection, create_engine

from benchmarks.cluster.runs import ADD, BEGIN, END, NAME, SEE, TELL, Setting

HEARTBEAT = 5.0
STALLED = 15.0
SWEEP = 5.0
QUICK = "-c synchronous_commit=off -c plan_cache_mode=force_custom_plan"


class Procrastinate:
    """The submitting side."""

    name = "Procrastinate"

    def __init__(self, url: str) -> None:
        self._app = App(connector=SyncPsycopgConnector(conninfo=url))
        self._engine = create_engine(url.replace("postgresql:", "postgresql+psycopg:"))

    def install(self) -> None:
        """Create the engine's tables."""
        with self._engine.begin() as connection:
            connection.connection.cursor().execute(self._app.schema_manager.get_schema())

    def submit(self, connection: Connection, seconds: float, priority: int = 0) -> int:
        """Add a row of `runs` and its job in the caller's transaction; return the row's id."""
        run_id: int = connection.exec_driver_sql(ADD).scalar_one()
        driver = connection.connection.driver_connection
        task = self._app.configure_task("run", queue="jobs", priority=priority, connection=driver)
        job_id = task.defer(run_id=run_id, seconds=seconds)
        connection.exec_driver_sql(NAME, (str(job_id), run_id))
        return run_id

    def cancel(self, run_id: int) -> None:
        """Cancel a job, running or not."""
        with self._engine.begin() as connection:
            found = connection.exec_driver_sql("SELECT engine_id FROM runs WHERE id = %s", (run_id,)).scalar_one()
            driver = connection.connection.driver_connection
            self._app.job_manager.cancel_job_by_id(int(found), abort=True, connection=driver)

    def clear(self) -> None:
        """Delete all jobs; no worker may run."""
        with self._engine.begin() as connection:
            connection.exec_driver_sql("TRUNCATE procrastinate_jobs CASCADE")

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()


def work(setting: Setting) -> None:
    """Run jobs until SIGTERM."""
    asyncio.run(_work(setting))


async def _work(setting: Setting) -> None:
    app = App(
        connector=PsycopgConnector(
            conninfo=setting.url,
            min_size=2,
            max_size=4 + setting.slots,
            pool_factory=_unchecked_pool if setting.quick else AsyncConnectionPool,
            kwargs={"options": QUICK} if setting.quick else {},
        )
    )
    async with AsyncConnectionPool(setting.url, min_size=1, max_size=setting.slots, open=False) as pool:
        _define(app, pool)
        async with app.open_async():
            sweep = asyncio.create_task(_sweep(app))
            running = asyncio.create_task(
                app.run_worker_async(
                    queues=["jobs"],
                    name=setting.name,
                    concurrency=setting.slots,
                    fetch_job_polling_interval=setting.poll,
                    update_heartbeat_interval=HEARTBEAT,
                    stalled_worker_timeout=STALLED,
                    shutdown_graceful_timeout=1,
                    delete_jobs="always",
                )
            )
            await asyncio.sleep(1)
            print("ready", flush=True)
            await running
            sweep.cancel()


def _unchecked_pool(**options: Any) -> AsyncConnectionPool[Any]:
    return AsyncConnectionPool(**(options | {"check": None}))


def _define(app: App, pool: AsyncConnectionPool[Any]) -> None:
    async def write(*statements: tuple[str, tuple[object, ...]]) -> None:
        async with pool.connection() as connection:
            for statement, values in statements:
                await connection.execute(statement.encode(), values)

    @app.task(name="run", queue="jobs")
    async def run(run_id: int, seconds: float) -> None:
        started = time.time()
        if seconds:
            await write((BEGIN, (started, run_id)))
            try:
                await asyncio.sleep(seconds)
            except asyncio.CancelledError:
                await write((SEE, (time.time(), run_id)))
                raise
        starts = [] if seconds else [started]
        await write((END, (starts, time.time(), run_id)), (TELL, (run_id,)))


async def _sweep(app: App) -> None:
    """Queue the jobs of dead workers again."""
    while True:
        await asyncio.sleep(SWEEP)
        for job in await app.job_manager.get_stalled_jobs(seconds_since_heartbeat=STALLED):
            with contextlib.suppress(Exception):  # another worker's sweep was faster
                await app.job_manager.retry_job(job, retry_at=datetime.now(UTC))
