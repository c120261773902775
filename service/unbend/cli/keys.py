"""`unbend keys`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

import click

from unbend.cli.options import json_option, library_option, warn

if TYPE_CHECKING:
    from unbend.library.engine import Store
    from unbend.library.keys import KeyRecord


@click.group()
def keys() -> None:
    """Make, list and revoke the API keys of a library.

    Once it has a key, its service asks for one; a server that runs knows at its next call.
    """


@keys.command("create")
@click.argument("name")
@click.option("--scope", type=click.Choice(["read", "write"]), default="read", show_default=True, help="write: both.")
@library_option
def create(name: str, scope: Literal["read", "write"], library: str | None) -> None:
    """Make a key called NAME and print it. It is shown this once: the library keeps only a hash."""
    from unbend.library.keys import create_key  # noqa: PLC0415

    with _store(library) as store, store.write() as connection:
        record, text = create_key(connection, name, scope)
    warn(f"unbend: key {record.id}, which may {scope}; it will not be shown again")
    click.echo(text)


@keys.command("list")
@library_option
@json_option
def list_all(library: str | None, as_json: bool) -> None:
    """List the keys, the revoked ones too, without their secrets."""
    from unbend.library.keys import list_keys  # noqa: PLC0415

    with _store(library) as store, store.read() as connection:
        records = list_keys(connection)
    click.echo(json.dumps({"keys": [_told(record) for record in records]}) if as_json else _table(records))


@keys.command("revoke")
@click.argument("key_id", metavar="ID")
@library_option
def revoke(key_id: str, library: str | None) -> None:
    """End the key with this ID for good."""
    from unbend.library.keys import revoke_key  # noqa: PLC0415

    with _store(library) as store, store.write() as connection:
        record = revoke_key(connection, key_id)
    click.echo(f"{record.id} ({record.name}) is revoked")


@contextmanager
def _store(url: str | None) -> Iterator[Store]:
    from unbend.library import Library  # noqa: PLC0415

    with Library(url or "unbend.db") as library:
        yield library.store


def _told(record: KeyRecord) -> dict[str, str | None]:
    revoked = record.revoked_at.isoformat() if record.revoked_at else None
    return vars(record) | {"created_at": record.created_at.isoformat(), "revoked_at": revoked}


def _table(records: list[KeyRecord]) -> str:
    if not records:
        return "the library has no keys"
    lines = [f"{'id':<14}{'scope':<8}{'made':<22}{'revoked':<22}name"]
    for record in records:
        revoked = f"{record.revoked_at:%Y-%m-%d %H:%M:%S}" if record.revoked_at else "-"
        lines.append(
            f"{record.id:<14}{record.scope:<8}{record.created_at:%Y-%m-%d %H:%M:%S}   {revoked:<22}{record.name}"
        )
    return "\n".join(lines)
