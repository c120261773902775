"""API keys: made, listed, revoked and recognised, within the caller's transaction.

A key is `unbend_<id>_<secret>`. The id finds its row, so that only one hash is compared, and in constant time; of the
secret only the hash is stored. A single SHA-256 is enough: slow hashes protect passwords, which are few enough to be
tried one by one. These secrets are 256 random bits, no easier to guess than the hash is to invert, and each request
would pay for a slow one.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, Literal, get_args

from sqlalchemy import Column, Connection, bindparam, exists, insert, select, update
from sqlalchemy.engine import Row

from unbend.errors import NotFoundError, ParameterError
from unbend.library.schema import api_keys
from unbend.names import MAX_TEXT

Scope = Literal["read", "write", "admin"]
"""The rights of a key. "write" includes "read". "admin" includes both, and sees and cancels the jobs of other keys."""

_PREFIX: Final = "unbend"
_ID_BYTES: Final = 6
_SECRET_BYTES: Final = 32
_COLUMNS: Final[tuple[Column[Any], ...]] = (
    api_keys.c.id,
    api_keys.c.name,
    api_keys.c.scope,
    api_keys.c.created_at,
    api_keys.c.revoked_at,
    api_keys.c.expires_at,
    api_keys.c.most_jobs,
)
# Made once: every request asks these.
_FIND = select(*_COLUMNS, api_keys.c.sha256).where(
    api_keys.c.id == bindparam("key_id"), api_keys.c.revoked_at.is_(None)
)
_ANY = select(exists().where(api_keys.c.revoked_at.is_(None)))
"""An expired key counts: a library does not open because its last key was forgotten."""


@dataclass(frozen=True)
class KeyRecord:
    """A key without its secret, which nobody has but its owner."""

    id: str
    name: str
    scope: Scope
    created_at: datetime
    revoked_at: datetime | None
    expires_at: datetime | None = None
    """From when it is refused; None for never."""
    most_jobs: int | None = None
    """Jobs of this key that may wait or run at a time; None for no limit of its own."""

    @property
    def is_expired(self) -> bool:
        """Whether its time is over."""
        return self.expires_at is not None and self.expires_at <= datetime.now(UTC)


def create_key(
    connection: Connection,
    name: str,
    scope: Scope,
    *,
    expires_at: datetime | None = None,
    most_jobs: int | None = None,
) -> tuple[KeyRecord, str]:
    """Make a key; return its record and its text, which cannot be had again.

    Raises
    ------
    ParameterError
        If the name is not 1 to 200 printable characters, there is no such scope, or the limits leave nothing.
    """
    if not 1 <= len(name) <= MAX_TEXT or not name.isprintable():
        raise ParameterError(f"a key's name must be text of 1 to {MAX_TEXT} printable characters")
    if scope not in get_args(Scope):
        raise ParameterError(f"a key's scope must be {', '.join(get_args(Scope))}, not {scope!r}")
    if most_jobs is not None and most_jobs < 1:
        raise ParameterError(f"a key must be allowed one job at least, not {most_jobs}")
    record = KeyRecord(secrets.token_hex(_ID_BYTES), name, scope, datetime.now(UTC), None, expires_at, most_jobs)
    if record.is_expired:
        raise ParameterError(f"the key would be expired already, at {expires_at}")
    secret = secrets.token_urlsafe(_SECRET_BYTES)
    connection.execute(insert(api_keys).values(**vars(record), sha256=_hash(secret)))
    return record, f"{_PREFIX}_{record.id}_{secret}"


def list_keys(connection: Connection) -> list[KeyRecord]:
    """Return all keys, the revoked ones too, in the order they were made."""
    rows = connection.execute(select(*_COLUMNS).order_by(api_keys.c.created_at, api_keys.c.id))
    return [_record(row) for row in rows]


def revoke_key(connection: Connection, key_id: str) -> KeyRecord:
    """End a key for good; one that was revoked before keeps its time. NotFoundError if there is none of this id."""
    connection.execute(
        update(api_keys)
        .where(api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None))
        .values(revoked_at=datetime.now(UTC))
    )
    row = connection.execute(select(*_COLUMNS).where(api_keys.c.id == key_id)).one_or_none()
    if row is None:
        raise NotFoundError(f"no key {key_id}")
    return _record(row)


def find_key(connection: Connection, text: str) -> KeyRecord | None:
    """Return the live key that this is the text of, if there is one."""
    prefix, _, rest = text.partition("_")
    key_id, _, secret = rest.partition("_")
    row = connection.execute(_FIND, {"key_id": key_id}).one_or_none()
    if prefix != _PREFIX or row is None or not hmac.compare_digest(row.sha256, _hash(secret)):
        return None
    return _record(row)


def has_keys(connection: Connection) -> bool:
    """Return whether any key is live: the library is then closed to callers without one."""
    return bool(connection.scalar(_ANY))


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode(errors="surrogatepass")).hexdigest()


def _record(row: Row[*tuple[Any, ...]]) -> KeyRecord:
    return KeyRecord(*(getattr(row, column.name) for column in _COLUMNS))
