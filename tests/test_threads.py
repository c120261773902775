"""Work on many items in threads."""

from __future__ import annotations

import threading

import pytest

from unbend.threads import share_out


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 100])
def test_every_item_is_worked_on_once_on_any_number_of_threads(count, threads):
    done, shares, lock = [], [], threading.Lock()

    def work(part: slice) -> None:
        with lock:
            done.extend(range(part.start, part.stop))

    share_out(count, threads, work, shares.append)
    assert sorted(done) == list(range(count))
    assert shares[-1:] == ([1.0] if count else [])
