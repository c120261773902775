"""API keys of a library.

A key is `unbend_<id>_<secret>`. The id selects one row, whose hash is compared in constant time. The store has only the
hash of the secret. A single SHA-256 is enough: slow hashes protect passwords, which attackers can guess. These secrets
are 256 random bits, and a slow hash would slow down every request.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final, Literal, get_args

from sqlalchemy import Column, Connection, bindparam, exists, insert, select, update
from sqlalchemy.engine import Row

from unbend.errors import NotFoundError, ParameterError
from unbend.library.storage.schema import api_keys
from unbend.library.storage.store import Store
from unbend.names import MAX_TEXT

Scope = Literal["read", "write", "admin"]
"""The rights of a key. "write" includes "read". "admin" includes both, and may see and cancel the jobs of all keys."""

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
# Built once, because every request runs these.
_FIND = select(*_COLUMNS, api_keys.c.sha256).where(
    api_keys.c.id == bindparam("key_id"), api_keys.c.revoked_at.is_(None)
)
_ANY = select(exists().where(api_keys.c.revoked_at.is_(None)))
"""Whether the library has a key that is not revoked.

Expired keys count: a library must not become open because its last key expired.
"""


@dataclass(frozen=True)
class KeyRecord:
    """A key without its secret."""

    id: str
    name: str
    scope: Scope
    created_at: datetime
    revoked_at: datetime | None
    expires_at: datetime | None = None
    """Time from which the key is refused; None for never."""
    most_jobs: int | None = None
    """Largest number of queued and running jobs of this key; None for no limit."""

    @property
    def is_expired(self) -> bool:
        """Whether the key has expired."""
        return self.expires_at is not None and self.expires_at <= datetime.now(UTC)


class Keys:
    """The API keys of a library; thread-safe."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def create(
        self, name: str, scope: Scope, *, expires_at: datetime | None = None, most_jobs: int | None = None
    ) -> tuple[KeyRecord, str]:
        """Create a key; return its record and its text, which cannot be read again.

        Raises
        ------
        ParameterError
            If the name is not 1 to 200 printable characters, there is no such scope, the key would be expired
            already, or it would be allowed no job.
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
        row = {**vars(record), "sha256": _hash(secret)}
        self._store.change(partial(_insert, row=row))
        return record, f"{_PREFIX}_{record.id}_{secret}"

    def all(self) -> list[KeyRecord]:
        """Return all keys, including revoked ones, in the order of their creation."""
        wanted = select(*_COLUMNS).order_by(api_keys.c.created_at, api_keys.c.id)
        return self._store.load(lambda connection: [_record(row) for row in connection.execute(wanted)])

    def revoke(self, key_id: str) -> KeyRecord:
        """Revoke a key; revoking it again changes nothing. NotFoundError if there is no key of this id."""
        return self._store.change(partial(_revoke, key_id=key_id))

    def are_required(self) -> bool:
        """Return whether callers need a key, because the library has one that is not revoked."""
        return self._store.load(_has_keys)

    def find(self, text: str) -> KeyRecord | None:
        """Return the key with this text if it is not revoked; it may have expired."""
        return self._store.load(partial(_find, text=text))

    async def find_async(self, text: str | None) -> tuple[KeyRecord | None, bool]:
        """Return the key with this text as `find` does, and whether callers need a key."""

        def find(connection: Connection) -> tuple[KeyRecord | None, bool]:
            key = _find(connection, text) if text else None
            return key, key is not None or _has_keys(connection)

        return await self._store.fetch(find, ("key", text))


def _insert(connection: Connection, row: Mapping[str, Any]) -> None:
    if connection.execute(_FIND, {"key_id": row["id"]}).one_or_none() is None:  # otherwise this change ran before
        connection.execute(insert(api_keys).values(**row))


def _revoke(connection: Connection, key_id: str) -> KeyRecord:
    connection.execute(
        update(api_keys)
        .where(api_keys.c.id == key_id, api_keys.c.revoked_at.is_(None))
        .values(revoked_at=datetime.now(UTC))
    )
    row = connection.execute(select(*_COLUMNS).where(api_keys.c.id == key_id)).one_or_none()
    if row is None:
        raise NotFoundError(f"no key {key_id}")
    return _record(row)


def _find(connection: Connection, text: str) -> KeyRecord | None:
    prefix, _, rest = text.partition("_")
    key_id, _, secret = rest.partition("_")
    row = connection.execute(_FIND, {"key_id": key_id}).one_or_none()
    if prefix != _PREFIX or row is None or not hmac.compare_digest(row.sha256, _hash(secret)):
        return None
    return _record(row)


def _has_keys(connection: Connection) -> bool:
    return bool(connection.scalar(_ANY))


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode(errors="surrogatepass")).hexdigest()


def _record(row: Row[*tuple[Any, ...]]) -> KeyRecord:
    return KeyRecord(*(getattr(row, column.name) for column in _COLUMNS))
