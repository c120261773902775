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

from unbend.cli.options import library_option
from unbend.errors import ExposedError

if TYPE_CHECKING:
    from unbend.api.connections import ConnectionLimits
    from unbend.api.settings import Settings
    from unbend.library import Library

_SHUTDOWN_SECONDS = 5  # that open requests, long polls above all, are given when the server stops

_BACKLOG = 2048  # uvicorn's own
_GARBAGE = 10_000  # objects made, beyond those gone, before garbage is looked for: a request makes hundreds


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True)
@click.option("--port", type=click.IntRange(0, 65535), default=8000, show_default=True)
@library_option
@click.option("--workers", metavar="N", type=click.IntRange(1, 256), help="Processes that compute; all cores.")
@click.option("--open", is_flag=True, help="Serve others without keys while there are none.")
@click.option(
    "--config", "file", metavar="FILE", type=click.Path(path_type=Path), envvar="UNBEND_CONFIG", help="Settings, TOML."
)
@click.pass_context
def serve(context: click.Context, /, host: str, port: int, file: Path | None, **_: object) -> None:
    """Start the web service.

    Its settings are environment variables with the prefix UNBEND_, or keys of a file. Options beat the environment,
    which beats the file.
    """
    import uvicorn  # noqa: PLC0415

    from unbend.api import create_app  # noqa: PLC0415
    from unbend.api.configuration import read_settings, without_password  # noqa: PLC0415
    from unbend.api.connections import HEAD_BYTES, connection_class  # noqa: PLC0415
    from unbend.api.logs import log_config  # noqa: PLC0415
    from unbend.api.serving import Server, bind  # noqa: PLC0415
    from unbend.heap import prepare as prepare_heap  # noqa: PLC0415
    from unbend.library.lease import Lease  # noqa: PLC0415

    settings = read_settings(_given(context), file)
    # In this order: a server that cannot listen touches no library, and one that has no lease changes none.
    stack = contextlib.ExitStack()
    context.call_on_close(stack.close)
    sockets = [stack.enter_context(bound) for bound in bind(host, port)]
    lease = stack.enter_context(Lease(settings.library))
    click.echo(f"unbend: library {without_password(settings.library)}, {settings.workers} workers", err=True)
    _must_be_safe(settings, host)
    app = create_app(settings, lease)
    limits, backlog = _within_handles(settings.connection_limits)
    config = uvicorn.Config(
        app,
        log_config=log_config(settings.log_format),
        access_log=False,
        # Named, for uvicorn would take what happens to be installed. httptools has no limit on a request's head, and
        # uvloop gives up listening where there are no more handles.
        http=connection_class(limits),
        backlog=backlog,
        h11_max_incomplete_event_size=HEAD_BYTES,
        loop="asyncio",
        ws="none",
        timeout_graceful_shutdown=_SHUTDOWN_SECONDS,
        # A caller on this machine could invent addresses in these headers, so nobody is trusted who is not named.
        proxy_headers=bool(settings.proxies),
        forwarded_allow_ips=settings.proxies,
    )
    prepare_heap()
    gc.freeze()  # what is there now stays: it need not be looked through again and again while requests wait
    gc.set_threshold(_GARBAGE)
    Server(config, app).run(sockets=sockets)


def _must_be_safe(settings: Settings, host: str) -> None:
    """Open the library, or end the command with a sentence; refuse to expose one that asks nobody for a key."""
    from unbend.library import Library  # noqa: PLC0415

    with Library(settings.library) as opened:
        if not (settings.open or _only_this_machine(host) or _closed(opened)):
            raise ExposedError(f"{host} can be reached by others, and the library has no keys")


def _given(context: click.Context) -> dict[str, Any]:
    """Return the settings given as options; those of the environment are read with all the others there."""
    return {
        name: context.params[name]
        for name in ("library", "workers", "open")
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    }


def _within_handles(limits: ConnectionLimits) -> tuple[ConnectionLimits, int]:
    """Have the system give this process all the handles it may, and leave a quarter of them to files and workers.

    Returns limits that fit, and how many connections may be accepted at a time: asyncio closes none in between.
    """
    try:
        import resource  # noqa: PLC0415
    except ImportError:  # Windows has no such limit
        return limits, _BACKLOG
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(OSError, ValueError):  # macOS tells a limit that it does not give
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    handles, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if handles == resource.RLIM_INFINITY:
        return limits, _BACKLOG
    fitting = replace(limits, connections=min(limits.connections, handles * 3 // 4))
    return fitting, min(_BACKLOG, (handles - fitting.connections) // 4)


def _only_this_machine(host: str) -> bool:
    """Whether every address that `host` stands for is loopback; a name that stands for none is not."""
    from unbend.api.addresses import is_loopback  # noqa: PLC0415

    try:
        found = socket.getaddrinfo(host, None) if host else []
    except OSError:
        return False
    return bool(found) and all(is_loopback(address[0]) for *_, address in found)


def _closed(library: Library) -> bool:
    from unbend.library.keys import has_keys  # noqa: PLC0415

    with library.store.read() as connection:
        return has_keys(connection)
