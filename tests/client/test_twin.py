"""The synchronous client is a copy of the asynchronous one."""

from __future__ import annotations

from tests.support.twin import SOURCE, TWIN, synchronous


def test_the_synchronous_client_is_made_from_the_asynchronous_one():
    assert TWIN.read_text() == synchronous(SOURCE.read_text()), "run `make client`"
