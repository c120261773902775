"""An object store with the bytes of meshes, named by their hashes: a bucket of a cloud, or a folder."""

from __future__ import annotations

import hashlib
import logging
import os
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from unbend.errors import ObjectDamagedError, ObjectMissingError, ObjectsUnavailableError, ParameterError
from unbend.extras import extra
from unbend.library.storage.disk import sync

if TYPE_CHECKING:
    from obstore.store import ClientConfig, LocalStore, RetryConfig

logger = logging.getLogger("unbend.objects")

_SCHEMES: Final = ("s3://", "gs://", "az://", "file:///")
_CLOUDS: Final = ("AWS", "GOOGLE", "AZURE")
_CLIENT: Final[ClientConfig] = {
    "connect_timeout": timedelta(seconds=5),
    "read_timeout": timedelta(seconds=30),
    "timeout": timedelta(minutes=15),  # of a whole file over a slow line
}
_RETRIES: Final[RetryConfig] = {
    "max_retries": 3,
    "retry_timeout": timedelta(seconds=15),
    "backoff": {"init_backoff": timedelta(milliseconds=100), "max_backoff": timedelta(seconds=2)},
}
_PART: Final = 8 * 2**20
"""Bytes of a part of an upload: a store takes at most 10,000 parts."""
_PARTS_AT_ONCE: Final = 4
_PIECE: Final = 2**20
_LISTED: Final = 1000
_KEY: Final = re.compile(r"([0-9a-f]{2})/([0-9a-f]{62})")

FOLDERS: Final = tuple(f"{number:02x}" for number in range(256))
"""The first two digits of hashes, which are the folders of the objects."""


@dataclass(frozen=True)
class StoredObject:
    """An object in a list."""

    sha256: str
    size: int
    modified: datetime


class Objects:
    """The objects of a library; thread-safe. The object of a hash `abcd...` is `ab/cd...` below the URL.

    Parameters
    ----------
    url : str
        Such as s3://bucket/prefix, gs://bucket/prefix, az://container/prefix or file:///folder. The environment has
        credentials, region and endpoint, under the names that obstore reads.

    Raises
    ------
    ParameterError
        If the URL names no object store.
    ExtraMissingError
        If the package obstore is not installed.

    Every method raises ObjectsUnavailableError if the store does not answer, or refuses.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self._store = _open(url)
        prefix = getattr(self._store, "prefix", None)
        self._folder = prefix if isinstance(prefix, Path) else None

    def put(self, sha256: str, content: bytes | BinaryIO) -> int:
        """Store the bytes of a mesh, and return their number. They appear complete or not at all, and are on disk.

        At most some megabytes of a file are in memory at a time.
        """
        size = len(content) if isinstance(content, bytes) else content.seek(0, os.SEEK_END)
        source: Any = content
        if not isinstance(content, bytes):
            content.seek(0)
            source = content.read() if size <= _PART else content
        with _typed("written", sha256):
            self._store.put(_key(sha256), source, chunk_size=_PART, max_concurrency=_PARTS_AT_ONCE)
            if self._folder is not None:
                path = self._folder / _key(sha256)
                for each in (path, path.parent, self._folder):
                    sync(each)
        return size

    def get(self, sha256: str) -> bytes:
        """Return the bytes of a mesh, checked against their hash.

        Raises
        ------
        ObjectMissingError
            If there is no such object.
        ObjectDamagedError
            If the object has other bytes.
        """
        found, pieces = hashlib.sha256(), []
        with _typed("read", sha256):
            for piece in self._store.get(_key(sha256)).stream(min_chunk_size=_PIECE):
                found.update(piece)
                pieces.append(bytes(piece))
        if found.hexdigest() != sha256:
            raise ObjectDamagedError(f"the object of mesh {sha256} in the object store has other bytes than its hash")
        return b"".join(pieces)

    def get_range(self, sha256: str, offset: int, size: int) -> bytes:
        """Return at most `size` bytes of a mesh from `offset`, unchecked; ObjectMissingError if there is no object."""
        with _typed("read", sha256):
            return bytes(self._store.get_range(_key(sha256), start=offset, length=size))

    def has(self, sha256: str) -> bool:
        """Return whether there is an object of this hash."""
        try:
            with _typed("read", sha256):
                self._store.head(_key(sha256))
        except ObjectMissingError:
            return False
        return True

    def delete(self, hashes: Collection[str]) -> None:
        """Delete the objects of these hashes, as far as they exist."""
        try:
            with _typed("deleted"):
                self._store.delete([_key(sha256) for sha256 in hashes])
        except ObjectMissingError:  # some stores then stop
            for sha256 in hashes:
                self._delete(sha256)

    def folders(self) -> set[str]:
        """Return the folders that have objects, of `FOLDERS`."""
        with _typed("listed"):
            return set(FOLDERS).intersection(self._store.list_with_delimiter()["common_prefixes"])

    def list(self, folder: str) -> Iterator[StoredObject]:
        """Yield the objects of a folder; files of others are left out."""
        with _typed("listed"):
            for page in self._store.list(folder, chunk_size=_LISTED):
                for item in page:
                    if found := _KEY.fullmatch(item["path"]):
                        yield StoredObject("".join(found.groups()), item["size"], item["last_modified"])

    def _delete(self, sha256: str) -> None:
        try:
            with _typed("deleted", sha256):
                self._store.delete(_key(sha256))
        except ObjectMissingError:
            return


def _open(url: str) -> Any:
    with extra("cluster"):
        from obstore.exceptions import BaseError  # noqa: PLC0415
        from obstore.store import LocalStore, from_url  # noqa: PLC0415
    if not url.startswith(_SCHEMES):
        raise ParameterError(f"{url}: an object store begins with one of {', '.join(_SCHEMES)}")
    try:
        if url.startswith("file:"):
            return _open_folder(LocalStore, url)
        return from_url(url, client_options=_client(), retry_config=_RETRIES)
    except (BaseError, OSError, ValueError) as error:
        raise ParameterError(f"{url}: the object store cannot be opened: {_first_line(error)}") from error


def _open_folder(kind: type[LocalStore], url: str) -> LocalStore:
    return kind.from_url(url, mkdir=True)


def _client() -> ClientConfig:
    """Return the options of the client; a store at http://, as in a test or a private network, must be allowed."""
    allowed = any(os.environ.get(f"{cloud}_ALLOW_HTTP", "").lower() in {"1", "true"} for cloud in _CLOUDS)
    return {**_CLIENT, "allow_http": True} if allowed else _CLIENT


def _key(sha256: str) -> str:
    return f"{sha256[:2]}/{sha256[2:]}"


@contextmanager
def _typed(done: str, sha256: str = "") -> Iterator[None]:
    """Replace errors of the store by typed errors, whose messages hide addresses and answers; the log has them."""
    from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError  # noqa: PLC0415

    try:
        yield
    except FileNotFoundError as error:
        if "NoSuchBucket" in str(error) or done == "written":
            raise _unavailable(done, "it has no such bucket", error) from error
        raise ObjectMissingError(f"the object of mesh {sha256} is missing in the object store") from error
    except (PermissionDeniedError, UnauthenticatedError, PermissionError) as error:
        raise _unavailable(done, "it refuses the credentials", error) from error
    except (BaseError, OSError) as error:
        raise _unavailable(done, "it does not answer, or reports an error", error) from error


def _unavailable(done: str, reason: str, error: Exception) -> ObjectsUnavailableError:
    logger.warning("the object store cannot be used: %s", _first_line(error))
    return ObjectsUnavailableError(f"the object store cannot be {done}: {reason}")


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
