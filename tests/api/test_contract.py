"""The service does what its OpenAPI document says, whatever is sent: schemathesis, with every check, in every phase."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.support.conformance import CHECK_NAMES, PHASES, Report, run
from tests.support.server import Server
from unbend.library import Library

EXAMPLES, STEPS = 5, 8


@pytest.fixture(scope="module")
def own_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that is given up to this module: it is left with thousands of odd requests behind it."""
    with Server(tmp_path_factory.mktemp("contract"), workers=1) as running:
        yield running


@pytest.fixture
def seed() -> int | None:
    """CI looks at the same requests every time, as it does for hypothesis."""
    return 1 if settings().derandomize else None


def look_at(report: Report) -> None:
    """A run that found nothing, and looked everywhere."""
    assert not report.failed, report.output
    assert {name: report.phases.get(name) for name in PHASES} == dict.fromkeys(PHASES, "success"), report.output
    assert len(CHECK_NAMES) > 10
    assert {name for name in CHECK_NAMES if not report.checks[name]} <= {"ignored_auth"}
    for phase in ("coverage", "fuzzing"):
        assert report.operations <= {label for where, label in report.cases if where == phase}
    # What was made up is not the same each time, so not everything that was asked of a shape need have found one.
    of_shapes = {label for label in report.operations if "{shape_id}" in label}
    answered = {label for label in of_shapes if report.accepted[label]}
    assert 2 * len(answered) > len(of_shapes) > 5, report.accepted
    assert report.longest >= 2
    assert report.followed


def test_an_open_service_keeps_its_contract(own_server: Server, tmp_path: Path, seed: int | None) -> None:
    look_at(run(own_server.url, tmp_path, examples=EXAMPLES, steps=STEPS, seed=seed))


def test_a_service_with_keys_keeps_its_contract(own_server: Server, tmp_path: Path, seed: int | None) -> None:
    with Library(str(own_server.library)) as library:
        _, key = library.keys.create("schemathesis", "write")
    report = run(own_server.url, tmp_path, examples=EXAMPLES, steps=STEPS, seed=seed, key=key)
    look_at(report)
    assert report.checks["ignored_auth"]
