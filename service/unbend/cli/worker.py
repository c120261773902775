"""`unbend worker`."""

from __future__ import annotations

import contextlib
from pathlib import Path

import click

from unbend.cli.options import library_option, objects_option
from unbend.cli.serve import config_option, given_settings, workers_option
from unbend.cli.terminal import warn
from unbend.errors import ParameterError


@click.command()
@library_option
@objects_option
@workers_option
@click.option("--host", default="127.0.0.1", show_default=True, help="Address or name to listen at.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8001,
    show_default=True,
    help="Port for probes and metrics; 0 for any free one.",
)
@config_option
@click.pass_context
def worker(context: click.Context, /, host: str, port: int, file: Path | None, **_: object) -> None:
    """Run the jobs of a cluster.

    The library must be in PostgreSQL. Any number of workers, and of servers (`unbend serve`), share it. Settings are
    those of `unbend serve`.
    """
    from unbend.jobs.process import start_fork_server  # noqa: PLC0415

    start_fork_server()  # first, so that it loads the kernels while this process imports the web framework
    import uvicorn  # noqa: PLC0415

    from unbend.api.server.configuration import read_settings  # noqa: PLC0415
    from unbend.api.server.logs import log_config  # noqa: PLC0415
    from unbend.api.server.opening import open_library  # noqa: PLC0415
    from unbend.api.server.serving import Server, bind  # noqa: PLC0415
    from unbend.api.worker import create_worker_app  # noqa: PLC0415
    from unbend.library.storage.database import is_shared, shown_url  # noqa: PLC0415

    settings = read_settings(given_settings(context), file)
    if not is_shared(settings.library):
        raise ParameterError("a worker needs a library in PostgreSQL").with_advice(
            "Run `unbend serve`, which runs the jobs of a library in SQLite itself."
        )
    if not settings.workers:
        raise ParameterError("a worker needs at least one process: set --workers")
    stack = contextlib.ExitStack()
    context.call_on_close(stack.close)
    sockets = [stack.enter_context(bound) for bound in bind(host, port)]
    warn(f"unbend: library {shown_url(settings.library)}, {settings.workers} workers")
    # Opened before, so that a library that cannot be opened is a message, and no traceback.
    open_library(settings).close()
    app = create_worker_app(settings)
    config = uvicorn.Config(
        app, log_config=log_config(settings.log_format), access_log=False, http="h11", loop="asyncio", ws="none"
    )
    Server(config, app).run(sockets=sockets)
