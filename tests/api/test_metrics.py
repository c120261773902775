"""The metrics of jobs and requests at /v1/metrics."""

from __future__ import annotations

import json
import uuid

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.support.server import DAMAGED, ENDLESS, SAMPLES, Server, ended, endless_mesh, post_mesh, small_mesh
from unbend import __version__
from unbend.progress import STAGES

FEW = json.dumps(SAMPLES)

Samples = dict[tuple[str, frozenset[tuple[str, str]]], float]


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    """A client of a server that receives no other requests."""
    with Server(tmp_path_factory.mktemp("metrics"), workers=1, drain_seconds=0) as own, own.http() as client:
        yield client


def scraped(http: httpx.Client) -> Samples:
    response = http.get("/v1/metrics")
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("text/plain; version=")
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(response.text)
        for sample in family.samples
    }


def value(samples: Samples, name: str, **labels: str) -> float:
    return samples.get((name, frozenset(labels.items())), 0.0)


def test_jobs_are_counted_by_kind_outcome_and_code(http):
    for number in (0, 1):
        assert ended(http, post_mesh(http, small_mesh(number), parameters=FEW))["state"] == "succeeded"
    assert ended(http, post_mesh(http, DAMAGED, file_name="bad.off"))["state"] == "failed"
    files = {"file": ("mesh.ply", small_mesh(0))}
    assert ended(http, http.post("/v1/queries", files=files, data={"parameters": FEW}))["state"] == "succeeded"
    running = [
        post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS | {"dimensions": dimensions}))
        for dimensions in (3, 4, 5)
    ]
    urls = [response.headers["Location"] for response in running]
    busy = scraped(http)
    assert value(busy, "unbend_jobs_running") + value(busy, "unbend_jobs_queued") == 3
    for url in reversed(urls):
        assert http.delete(url).json()["state"] == "cancelled"
    http.delete(urls[0])  # a second cancellation is not counted

    found = scraped(http)
    counts = {key: count for key, count in found.items() if key[0] == "unbend_jobs_total"}
    assert counts == {
        ("unbend_jobs_total", frozenset({"kind": kind, "outcome": outcome, "code": code}.items())): count
        for kind, outcome, code, count in [
            ("shape", "succeeded", "", 2),
            ("shape", "failed", "mesh_read", 1),
            ("shape", "cancelled", "job_cancelled", 3),
            ("query", "succeeded", "", 1),
        ]
    }
    for stage in STAGES[1:]:
        assert value(found, "unbend_stage_seconds_count", stage=stage) == 3
    stages = sum(value(found, "unbend_stage_seconds_sum", stage=stage) for stage in STAGES)
    jobs = sum(value(found, "unbend_job_seconds_sum", kind=kind, outcome="succeeded") for kind in ("shape", "query"))
    assert 0 < stages < jobs
    assert value(found, "unbend_job_seconds_count", kind="shape", outcome="succeeded") == 2
    assert value(found, "unbend_job_wait_seconds_count", kind="query") == 1
    assert value(found, "unbend_workers") == 1
    assert value(found, "unbend_library_shapes") == 2
    assert value(found, "unbend_jobs_queued") == 0
    assert value(found, "unbend_build_info", version=__version__) == 1
    assert value(found, "process_resident_memory_bytes") > 1e7
    assert value(found, "process_cpu_seconds_total") > 0


def test_requests_are_counted_by_route_template_and_never_by_path(http):
    def count(samples: Samples, method: str, route: str, status: int) -> float:
        return value(samples, "unbend_http_request_seconds_count", method=method, route=route, status=str(status))

    before = scraped(http)
    for _ in range(5):
        unknown = uuid.uuid4().hex
        assert http.get(f"/v1/shapes/{unknown}").status_code == 404
        assert http.get(f"/v1/{unknown}").status_code == 404
        assert http.get(f"/{unknown}/x").status_code == 404
        assert http.get(f"/docs-assets/{unknown}").status_code == 404
        assert http.request(unknown[:8].upper(), "/v1/shapes").status_code == 405
    assert http.get("/v1/shapes").status_code == 200
    after = scraped(http)
    for method, route, status, more in [
        ("GET", "/v1/shapes/{shape_id}", 404, 5),
        ("GET", "unmatched", 404, 15),
        ("other", "/v1/shapes", 405, 5),
        ("GET", "/v1/shapes", 200, 1),
    ]:
        assert count(after, method, route, status) - count(before, method, route, status) == more, route
    templates = {*http.get("/openapi.json").json()["paths"], "unmatched", "/", "/docs", "/redoc", "/openapi.json"}
    routes = {dict(labels)["route"] for name, labels in after if name == "unbend_http_request_seconds_count"}
    assert routes <= templates
