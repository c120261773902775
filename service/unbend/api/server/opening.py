"""The opening of a server's library."""

from __future__ import annotations

from unbend.api.server.settings import Settings
from unbend.library import Library
from unbend.library.storage.migration import must_be_migrated


def open_library(settings: Settings) -> Library:
    """Open the library of a server or a worker, and migrate it if the settings allow that.

    Raises
    ------
    StoreOutdatedError
        If the library has an older schema, or none, and the settings do not allow migrations.
    StoreError
        If it cannot be opened; StoreVersionError if a later version of unbend made it.
    """
    if not settings.migrate:
        must_be_migrated(settings.library)
    return Library(settings.library, migrate=settings.migrate, search=settings.search, objects=settings.objects or None)
