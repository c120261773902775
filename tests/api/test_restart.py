"""Jobs that a killed or stopped server had accepted are run by the next server."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import threading
import time

import httpx

from tests.support.server import (
    DAMAGED,
    ENDLESS,
    SAMPLES,
    Server,
    ended,
    endless_mesh,
    is_running,
    post_mesh,
    small_mesh,
)

FEW = json.dumps(SAMPLES)
PATIENCE = 60.0


def until(reached, seconds: float = PATIENCE) -> None:
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_every_job_acknowledged_before_a_kill_ends_after_a_restart(tmp_path):
    with Server(tmp_path, workers=2) as first, first.http() as http:
        accepted = [post_mesh(http, small_mesh(number), name=f"n{number}", parameters=FEW) for number in range(20)]
        accepted.append(post_mesh(http, DAMAGED, file_name="bad.off"))
        accepted.append(post_mesh(http, small_mesh(50), parameters='{"samples": 5000}', name="last"))
        first.kill()
    assert {response.status_code for response in accepted} == {202}
    with Server(tmp_path, workers=2) as second, second.http() as http:
        jobs = [ended(http, response) for response in accepted]
        states = [job["state"] for job in jobs]
        assert states == ["succeeded"] * 20 + ["failed", "succeeded"]
        names = [item["name"] for item in http.get("/v1/shapes").json()["items"]]
        assert sorted(names) == sorted([f"n{number}" for number in range(20)] + ["last"])
        assert len({job["shape_id"] for job in jobs if job["shape_id"]}) == 21
        for number, job in enumerate(jobs[:20]):
            assert http.get(f"/v1/shapes/{job['shape_id']}/mesh").content == small_mesh(number)


def test_the_workers_of_a_killed_server_exit(tmp_path):
    with Server(tmp_path, workers=2) as server, server.http() as http:
        accepted = post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS))
        url = accepted.headers["Location"]
        until(lambda: http.get(url).json()["stage"] == "geodesics")
        left = server.workers()
        assert len(left) == 2
        server.kill()
        try:
            until(lambda: not any(map(is_running, left)), seconds=20.0)
        finally:
            for pid in filter(is_running, left):
                os.kill(pid, signal.SIGKILL)


def test_a_stopped_server_exits_within_ten_seconds_and_requeues_running_jobs(tmp_path):
    with Server(tmp_path, workers=1, drain_seconds=0) as server, server.http() as http:
        url = post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS)).headers["Location"]
        until(lambda: http.get(url).json()["stage"] == "geodesics")
        workers = server.workers()
        waiting = threading.Thread(target=poll, args=(server.url + url,))
        waiting.start()
        time.sleep(0.3)  # so that the server has received the long poll
        server.process.send_signal(signal.SIGTERM)
        try:
            # Containers get ten seconds by default, and a client that waits for a job must not delay the exit.
            server.process.wait(10)
        finally:
            server.stop()
            waiting.join()
        assert not any(map(is_running, workers))
        assert "Traceback" not in server.log.read_text()
    with Server(tmp_path, workers=1, ready=False, drain_seconds=0) as again, again.http() as http:
        job = http.get(url).json()
        assert job["state"] in {"queued", "running"}
        assert job["attempts"] <= 1
        assert http.delete(url).json()["state"] == "cancelled"


def poll(url: str) -> None:
    with contextlib.suppress(httpx.TransportError):
        httpx.get(url, params={"wait": 60}, timeout=90)
