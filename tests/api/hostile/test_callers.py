"""Clients that forge their address, and clients that disconnect."""

from __future__ import annotations

import json
import time

import httpx
import pytest

from tests.support.server import SAMPLES, Server, endless_mesh, small_mesh

PATIENCE = 60.0


def test_a_forged_forwarded_address_does_not_evade_the_rate_limit(tmp_path):
    with Server(tmp_path, workers=1, ready=False, requests_per_minute=10) as server, server.http() as http:
        answers = [
            http.get("/v1/shapes", headers={"X-Forwarded-For": f"198.51.100.{number}"}).status_code
            for number in range(30)
        ]
    assert 429 in answers
    assert 200 not in answers  # a library without keys is open only to this machine, not to forwarded clients


def test_a_trusted_proxy_forwards_the_client_address(tmp_path):
    settings = {"requests_per_minute": 5, "trusted_proxies": "127.0.0.1", "open": "true"}
    with Server(tmp_path, workers=1, ready=False, **settings) as server, server.http() as http:
        for number in range(20):
            answer = http.get("/v1/shapes", headers={"X-Forwarded-For": f"198.51.100.{number}"})
            assert answer.status_code == 200
        answers = [http.get("/v1/shapes", headers={"X-Forwarded-For": "198.51.100.1"}).status_code for _ in range(10)]
        assert 429 in answers


def test_a_query_is_cancelled_when_its_client_disconnects(tmp_path):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        form = {"files": {"file": ("m.ply", endless_mesh())}, "data": {"parameters": json.dumps({"samples": 2000})}}
        with pytest.raises(httpx.ReadTimeout):
            http.post("/v1/queries", **form, headers={"Prefer": "wait=30"}, timeout=3.0)
        end = time.monotonic() + PATIENCE
        while {job["state"] for job in http.get("/v1/jobs").json()["items"]} != {"cancelled"}:
            assert time.monotonic() < end
            time.sleep(0.1)


def test_a_query_answered_with_a_job_continues_after_a_restart(tmp_path):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        form = {"files": {"file": ("m.ply", small_mesh(1))}, "data": {"parameters": json.dumps(SAMPLES)}}
        job = http.post("/v1/queries", **form).json()
    with Server(tmp_path, workers=1) as server, server.http() as http:
        assert http.get(f"/v1/jobs/{job['id']}", params={"wait": 30}).json()["state"] == "succeeded"
