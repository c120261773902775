"""Fixtures of a new library, in each database."""

from __future__ import annotations

import pytest

from unbend import Library


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run tests of a library in each database, except those that look at its file."""
    if "database" not in metafunc.fixturenames:
        return
    known = getattr(metafunc.module, "DATABASES", ("sqlite", "postgresql"))
    chosen = ["sqlite"] if "path" in metafunc.fixturenames else known
    metafunc.parametrize("database", chosen, scope="module")  # so that tests may share a library in each database


@pytest.fixture
def path(tmp_path):
    """The file of the library: only SQLite has one."""
    return tmp_path / "library.db"


@pytest.fixture
def url(database, tmp_path, request):
    """The address of the library."""
    return str(tmp_path / "library.db") if database == "sqlite" else request.getfixturevalue("postgres_url")


@pytest.fixture
def library(url):
    with Library(url) as opened:
        yield opened
