"""The addresses by which a process opens a library."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LibraryAddress:
    """The address of a library's database, and of its object store."""

    url: str
    objects: str | None = None
    """None if the database has all files."""
