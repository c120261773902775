"""`unbend keys`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Literal

import click

from unbend.cli.group import CommandGroup
from unbend.cli.options import json_option, library_option
from unbend.cli.places import check_library
from unbend.cli.tables import table, timestamp
from unbend.cli.terminal import confirm, print_result, warn

if TYPE_CHECKING:
    from unbend.library.keys import KeyRecord, Keys


@click.group(cls=CommandGroup)
def keys() -> None:
    """Make, list and revoke the API keys of a library.

    A library with keys needs one for every request. A running server applies a change to the next request.
    """


@keys.command("create")
@click.argument("name")
@click.option(
    "--scope",
    type=click.Choice(["read", "write", "admin"]),
    default="read",
    show_default=True,
    help="write includes read; admin includes both, and the jobs of other keys.",
)
@click.option("--expires", metavar="WHEN", help="Time of expiry: 90d, 12h, or a date such as 2027-01-31.")
@click.option("--most-jobs", type=click.IntRange(1), help="Maximum number of queued and running jobs of this key.")
@library_option
@json_option
def create(
    name: str,
    scope: Literal["read", "write", "admin"],
    expires: str | None,
    most_jobs: int | None,
    library: str,
    as_json: bool,
) -> None:
    """Make a key named NAME and print it. The key is shown only once, because the library stores only its hash."""
    until = _parse_expiry(expires) if expires else None
    with _keys(library) as stored:
        record, text = stored.create(name, scope, expires_at=until, most_jobs=most_jobs)
    warn(f"unbend: key {record.id}, which may {scope}; it will not be shown again")
    print_result(_as_json(record) | {"key": text}, text, as_json=as_json)


@keys.command("list")
@library_option
@json_option
def list_all(library: str, as_json: bool) -> None:
    """List the keys, including revoked ones, without their secrets."""
    check_library(library)
    with _keys(library) as stored:
        records = stored.all()
    print_result({"keys": [_as_json(record) for record in records]}, lambda: _table(records), as_json=as_json)


@keys.command("revoke")
@click.argument("key_id", metavar="ID")
@library_option
@json_option
def revoke(key_id: str, library: str, as_json: bool) -> None:
    """Revoke the key with this ID for good."""
    check_library(library)
    with _keys(library) as stored:
        record = stored.revoke(key_id)
    confirm(_as_json(record), f"{record.id} ({record.name}) is revoked", as_json=as_json)


@contextmanager
def _keys(url: str) -> Iterator[Keys]:
    from unbend.library import Library  # noqa: PLC0415

    with Library(url) as library:
        yield library.keys


def _parse_expiry(text: str) -> datetime:
    """Return the time of `90d`, `12h`, or a date with an optional time, in UTC unless it has an offset."""
    if found := re.fullmatch(r"(\d{1,5})([dh])", text):
        return datetime.now(UTC) + timedelta(**{"days" if found[2] == "d" else "hours": int(found[1])})
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise click.BadParameter(f"{text!r} is not like 90d, 12h or 2027-01-31", param_hint="--expires") from None
    return instant if instant.tzinfo else instant.replace(tzinfo=UTC)


def _as_json(record: KeyRecord) -> dict[str, object]:
    values = {name: value.isoformat() if isinstance(value, datetime) else value for name, value in vars(record).items()}
    return values | {"expired": record.is_expired}


def _table(records: list[KeyRecord]) -> str:
    if not records:
        return "the library has no keys"
    rows = [
        [record.id, record.scope, *map(timestamp, _times(record)), record.most_jobs, record.name] for record in records
    ]
    return table(["id", "scope", "made", "revoked", "expires", "jobs", "name"], rows)


def _times(record: KeyRecord) -> tuple[datetime | None, ...]:
    return record.created_at, record.revoked_at, record.expires_at
