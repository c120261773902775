"""`unbend serve`."""

from __future__ import annotations

import contextlib
import gc
import socket
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from unbend.cli.options import chosen_objects, library_option, objects_option
from unbend.cli.terminal import warn
from unbend.errors import ExposedError

if TYPE_CHECKING:
    from unbend.api.server.connections import ConnectionLimits
    from unbend.api.server.settings import Settings

_SHUTDOWN_SECONDS = 5  # time for open requests when the server stops

_BACKLOG = 2048  # uvicorn's default
_GARBAGE = 10_000  # net new objects before a garbage collection: a request creates hundreds

workers_option = click.option(
    "--workers",
    metavar="N",
    type=click.IntRange(0, 256),
    help="Worker processes; one for each core by default. 0 if `unbend worker` runs the jobs elsewhere.",
)
config_option = click.option(
    "--config",
    "file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    envvar="UNBEND_CONFIG",
    show_envvar=True,
    help="Settings, in TOML.",
)


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True, help="Address or name to listen at.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8000, show_default=True, help="Port; 0 for any free one."
)
@library_option
@objects_option
@workers_option
@click.option("--open", is_flag=True, help="Serve everybody as long as the library has no keys.")
@config_option
@click.pass_context
def serve(context: click.Context, /, host: str, port: int, file: Path | None, **_: object) -> None:
    """Start the web service.

    Settings are environment variables with the prefix UNBEND_, or keys of a file. Options override the environment,
    which overrides the file.
    """
    from unbend.jobs.process import start_fork_server  # noqa: PLC0415

    start_fork_server()  # first, so that it loads the kernels while this process imports the web framework
    import uvicorn  # noqa: PLC0415

    from unbend.api import create_app  # noqa: PLC0415
    from unbend.api.server.configuration import read_settings  # noqa: PLC0415
    from unbend.api.server.connections import HEAD_BYTES, connection_class  # noqa: PLC0415
    from unbend.api.server.logs import log_config  # noqa: PLC0415
    from unbend.api.server.serving import Server, bind  # noqa: PLC0415
    from unbend.heap import prepare as prepare_heap  # noqa: PLC0415
    from unbend.library.storage.database import shown_url  # noqa: PLC0415
    from unbend.library.storage.lease import Lease  # noqa: PLC0415

    settings = read_settings(given_settings(context), file)
    # In this order: a server that cannot listen opens no library, and a server without the lease changes no library.
    stack = contextlib.ExitStack()
    context.call_on_close(stack.close)
    sockets = [stack.enter_context(bound) for bound in bind(host, port)]
    lease = stack.enter_context(Lease(settings.library))
    warn(f"unbend: library {shown_url(settings.library)}, {settings.workers} workers")
    _must_be_safe(settings, host)
    app = create_app(settings, lease)
    limits, backlog = _fit_file_descriptors(settings.connection_limits)
    config = uvicorn.Config(
        app,
        log_config=log_config(settings.log_format),
        access_log=False,
        # Explicit, because uvicorn would use the packages that are installed. httptools does not limit the head of a
        # request, and uvloop stops listening when it runs out of file descriptors.
        http=connection_class(limits),
        backlog=backlog,
        h11_max_incomplete_event_size=HEAD_BYTES,
        loop="asyncio",
        ws="none",
        timeout_graceful_shutdown=_SHUTDOWN_SECONDS,
        # Callers could forge addresses in these headers, so only the proxies in the settings are trusted.
        proxy_headers=bool(settings.proxies),
        forwarded_allow_ips=settings.proxies,
    )
    prepare_heap()
    gc.freeze()  # the present objects stay alive: exclude them from garbage collections
    gc.set_threshold(_GARBAGE)
    Server(config, app).run(sockets=sockets)


def _must_be_safe(settings: Settings, host: str) -> None:
    """Open the library, or exit with a message; refuse to expose a library without keys."""
    from unbend.api.server.opening import open_library  # noqa: PLC0415

    with open_library(settings) as opened:
        if not (settings.open or _only_this_machine(host) or opened.keys.are_required()):
            raise ExposedError(f"{host} is public, and the library has no keys")


def given_settings(context: click.Context) -> dict[str, Any]:
    """Return the settings from options; `read_settings` reads the environment."""
    params = {**context.params, "objects": chosen_objects()}
    return {
        name: params[name]
        for name in ("library", "objects", "workers", "open")
        if name in params and context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    }


def _fit_file_descriptors(limits: ConnectionLimits) -> tuple[ConnectionLimits, int]:
    """Raise the limit of file descriptors as far as allowed, and reserve a quarter of them for files and workers.

    Return limits that fit, and a backlog: asyncio accepts up to that many connections in one step, and closes none
    during the step.
    """
    try:
        import resource  # noqa: PLC0415
    except ImportError:  # Windows has no such limit
        return limits, _BACKLOG
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(OSError, ValueError):  # macOS reports a limit that it does not grant
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    handles, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if handles == resource.RLIM_INFINITY:
        return limits, _BACKLOG
    fitting = replace(limits, connections=min(limits.connections, handles * 3 // 4))
    return fitting, min(_BACKLOG, (handles - fitting.connections) // 4)


def _only_this_machine(host: str) -> bool:
    """Return whether every address of `host` is loopback; False for a name without addresses."""
    from unbend.api.server.addresses import is_loopback  # noqa: PLC0415

    try:
        found = socket.getaddrinfo(host, None) if host else []
    except OSError:
        return False
    return bool(found) and all(is_loopback(address[0]) for *_, address in found)
