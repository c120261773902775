"""Tests the service against its OpenAPI document with every check and every phase of schemathesis."""

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
    """A server for this module alone, because thousands of random requests change its library."""
    with Server(tmp_path_factory.mktemp("contract"), workers=1) as running:
        yield running


@pytest.fixture
def seed() -> int | None:
    """A fixed seed where hypothesis is derandomized (in CI), so that every run sends the same requests."""
    return 1 if settings().derandomize else None


def check_report(report: Report) -> None:
    """Check that a run found no failure and reached every operation."""
    assert not report.failed, report.output
    assert {name: report.phases.get(name) for name in PHASES} == dict.fromkeys(PHASES, "success"), report.output
    assert len(CHECK_NAMES) > 10
    assert {name for name in CHECK_NAMES if not report.checks[name]} <= {"ignored_auth"}
    for phase in ("coverage", "fuzzing"):
        assert report.operations <= {label for where, label in report.cases if where == phase}
    # Requests are random, so some operations on a shape may never have met an existing shape.
    of_shapes = {label for label in report.operations if "{shape_id}" in label}
    answered = {label for label in of_shapes if report.accepted[label]}
    assert 2 * len(answered) > len(of_shapes) > 5, report.accepted
    assert report.longest >= 2
    assert report.followed


def test_a_service_without_keys_conforms_to_its_openapi_document(
    own_server: Server, tmp_path: Path, seed: int | None
) -> None:
    check_report(run(own_server.url, tmp_path, examples=EXAMPLES, steps=STEPS, seed=seed))


def test_a_service_with_keys_conforms_to_its_openapi_document(
    own_server: Server, tmp_path: Path, seed: int | None
) -> None:
    with Library(str(own_server.library)) as library:
        _, key = library.keys.create("schemathesis", "write")
    report = run(own_server.url, tmp_path, examples=EXAMPLES, steps=STEPS, seed=seed, key=key)
    check_report(report)
    assert report.checks["ignored_auth"]
