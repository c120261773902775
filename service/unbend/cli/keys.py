"""`unbend keys`."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
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
@click.option(
    "--scope",
    type=click.Choice(["read", "write", "admin"]),
    default="read",
    show_default=True,
    help="write: both; admin: the jobs of other keys, too.",
)
@click.option("--expires", metavar="WHEN", help="From when it is refused: 90d, 12h, or an instant such as 2027-01-31.")
@click.option("--most-jobs", type=click.IntRange(1), help="Jobs of this key that may wait or run at a time.")
@library_option
def create(
    name: str, scope: Literal["read", "write", "admin"], expires: str | None, most_jobs: int | None, library: str | None
) -> None:
    """Make a key called NAME and print it. It is shown this once: the library keeps only a hash."""
    from unbend.library.keys import create_key  # noqa: PLC0415

    until = _instant(expires) if expires else None
    with _store(library) as store, store.write() as connection:
        record, text = create_key(connection, name, scope, expires_at=until, most_jobs=most_jobs)
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


def _instant(text: str) -> datetime:
    """Return the instant that `90d`, `12h`, or a date, perhaps with a time, stands for; days begin in UTC."""
    if found := re.fullmatch(r"(\d{1,5})([dh])", text):
        return datetime.now(UTC) + timedelta(**{"days" if found[2] == "d" else "hours": int(found[1])})
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not like 90d, 12h or 2027-01-31", param_hint="--expires") from None
    return instant if instant.tzinfo else instant.replace(tzinfo=UTC)


def _told(record: KeyRecord) -> dict[str, object]:
    told = {name: value.isoformat() if isinstance(value, datetime) else value for name, value in vars(record).items()}
    return told | {"expired": record.is_expired}


def _table(records: list[KeyRecord]) -> str:
    if not records:
        return "the library has no keys"
    lines = [f"{'id':<14}{'scope':<8}{'made':<22}{'revoked':<22}{'expires':<22}{'jobs':<7}name"]
    for record in records:
        times = "".join(
            f"{time:%Y-%m-%d %H:%M:%S}   " if time else f"{'-':<22}"
            for time in (record.created_at, record.revoked_at, record.expires_at)
        )
        lines.append(f"{record.id:<14}{record.scope:<8}{times}{record.most_jobs or '-':<7}{record.name}")
    return "\n".join(lines)
