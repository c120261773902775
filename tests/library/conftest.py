"""Fixtures of a new library in its own file."""

from __future__ import annotations

import pytest

from unbend import Library


@pytest.fixture
def path(tmp_path):
    return tmp_path / "library.db"


@pytest.fixture
def library(path):
    with Library(str(path)) as opened:
        yield opened
