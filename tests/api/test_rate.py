"""The token bucket of the rate limit, with a simulated clock."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from unbend.api.middleware.rate_limit import RateLimit


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def test_a_bucket_holds_the_requests_of_a_minute_and_refills_evenly():
    clock = Clock()
    limit = RateLimit(6, clock)
    assert [limit.take("a") for _ in range(7)] == [0] * 6 + [10]
    clock.now += 4
    assert limit.take("a") == 6
    clock.now += 6
    assert [limit.take("a"), limit.take("a")] == [0, 10]
    assert limit.take("b") == 0
    clock.now += 600
    assert [limit.take("a") for _ in range(7)] == [0] * 6 + [10]


def test_no_limit_never_waits():
    limit = RateLimit(0, Clock())
    assert {limit.take("a") for _ in range(1000)} == {0}


@given(per_minute=st.integers(1, 90), pauses=st.lists(st.floats(0, 20), max_size=200))
def test_the_rate_limit_behaves_like_a_token_bucket(per_minute, pauses):
    clock, tokens = Clock(), float(per_minute)
    limit = RateLimit(per_minute, clock)
    for pause in pauses:
        clock.now += pause
        tokens = min(per_minute, tokens + pause * per_minute / 60)
        wait = limit.take("a")
        if wait == 0:
            assert tokens > 1 - 1e-6  # tolerance for rounding
            tokens = max(tokens - 1, 0)
        else:
            assert tokens < 1 + 1e-6
            assert wait - 1 < (1 - tokens) * 60 / per_minute + 1e-3
            assert wait >= 1


def test_only_callers_with_full_buckets_are_evicted():
    clock = Clock()
    limit = RateLimit(1, clock)
    for number in range(10_000):
        limit.take(str(number))
    assert limit.take("late") == 0
    assert [limit.take("0"), limit.take("9999"), limit.take("late")] == [60, 60, 60]
    clock.now += 61
    assert limit.take("later") == 0
    assert limit.take("0") == 0
