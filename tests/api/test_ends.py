"""How servers start and stop: ports, second servers, signals, removed libraries, and full disks."""

from __future__ import annotations

import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from tests.support.disk import small_disk
from tests.support.problem import check
from tests.support.server import (
    ENDLESS,
    SAMPLES,
    Server,
    ended,
    endless_mesh,
    medium_mesh,
    post_mesh,
    small_mesh,
    without_settings,
)

FEW = json.dumps(SAMPLES)
PATIENCE = 60.0


def until(reached, seconds: float = PATIENCE) -> None:
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.05)


def serve(folder, *options: str) -> subprocess.CompletedProcess[str]:
    """Run `unbend serve`, which is expected to exit by itself."""
    command = [sys.executable, "-m", "unbend", "serve", "--library", str(folder / "library.db"), *options]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE, env=without_settings(), cwd=folder, check=False
    )


def test_a_second_server_on_one_library_exits_and_takes_no_job(tmp_path):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        accepted = post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS))
        url = accepted.headers["Location"]
        until(lambda: http.get(url).json()["state"] == "running")
        before = http.get(url).json()
        for _ in range(3):
            refused = serve(tmp_path, "--port", "0", "--workers", "1")
            assert refused.returncode == 3
            assert (
                f"another server runs the jobs of {server.library} already: process {server.process.pid}"
                in refused.stderr
            )
            assert "Traceback" not in refused.stderr
        job = http.get(url).json()
        assert (job["state"], job["attempts"]) == ("running", 1)
        assert job["started_at"] == before["started_at"]
        http.delete(url)


def test_a_port_in_use_ends_the_command_before_it_creates_the_library(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused = serve(tmp_path, "--port", str(port))
    assert refused.returncode == 1
    assert f"cannot listen on 127.0.0.1 port {port}" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_all_processes_lets_running_jobs_finish(tmp_path, number):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        job = post_mesh(http, medium_mesh()).json()
        until(lambda: http.get(f"/v1/jobs/{job['id']}").json()["state"] == "running")
        for pid in (*server.workers(), server.process.pid):
            os.kill(pid, number)
        server.process.wait(PATIENCE)
    with Server(tmp_path, workers=1, ready=False) as server, server.http() as http:
        found = http.get(f"/v1/jobs/{job['id']}").json()
        assert (found["state"], found["attempts"]) == ("succeeded", 1)


def test_repeated_interrupts_end_a_server_at_once_and_the_next_server_runs_its_job(tmp_path):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        job = post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS)).json()
        until(lambda: http.get(f"/v1/jobs/{job['id']}").json()["state"] == "running")
        begun = time.monotonic()
        while server.process.poll() is None:
            for pid in (*server.workers(), server.process.pid):
                os.kill(pid, signal.SIGINT)
            time.sleep(0.1)
        assert time.monotonic() - begun < 15.0
    with Server(tmp_path, workers=1, ready=False) as server, server.http() as http:
        found = http.get(f"/v1/jobs/{job['id']}").json()
        assert found["state"] in {"queued", "running"}
        assert found["attempts"] <= 1
        http.delete(f"/v1/jobs/{job['id']}")


def test_a_stopped_worker_is_replaced_and_its_job_succeeds(tmp_path):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        for pid in server.workers():
            os.kill(pid, signal.SIGSTOP)
        job = ended(http, post_mesh(http, small_mesh(1), parameters=FEW))
        assert (job["state"], job["attempts"]) == ("succeeded", 1)


def test_a_server_whose_library_was_removed_refuses_requests(tmp_path):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        ended(http, post_mesh(http, small_mesh(1), parameters=FEW))
        server.library.rename(server.library.with_suffix(".old"))
        ready = http.get("/v1/readyz")
        assert ready.status_code == 503
        assert "library.db was removed or replaced" in ready.json()["detail"]
        check(post_mesh(http, small_mesh(2), parameters=FEW), 503, "store_lost")
        check(http.get("/v1/shapes"), 503, "store_lost")
        assert http.get("/v1/livez").status_code == 200
        server.process.send_signal(signal.SIGTERM)
        server.process.wait(PATIENCE)
    assert not server.library.exists()


def test_a_server_on_a_full_disk_refuses_uploads_but_can_remove_shapes_and_stop(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        with (
            small_disk(folder, 48),
            Server(folder, workers=1, reserve_mb=8, max_upload_mb=4) as server,
            server.http() as http,
        ):
            check_full_disk(http, folder)
            server.process.send_signal(signal.SIGTERM)
            server.process.wait(30)
    except PermissionError:
        pytest.skip("only root can mount a disk of its own")


def check_full_disk(http, folder) -> None:
    first = ended(http, post_mesh(http, small_mesh(1), parameters=FEW))["shape_id"]
    running = post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS)).headers["Location"]
    until(lambda: http.get(running).json()["state"] == "running")
    other = folder / "other"
    with other.open("wb") as file:  # another program fills the disk
        try:
            while True:
                file.write(bytes(2**16))
                file.flush()
        except OSError:
            pass
    refused = [post_mesh(http, small_mesh(number), parameters=FEW) for number in range(2, 6)]
    for response in refused:
        check(response, 507, "store_full")
    ready = http.get("/v1/readyz")
    assert ready.status_code == 503
    assert "disk has no space" in ready.json()["detail"]
    assert http.get("/v1/livez").status_code == 200
    assert "unbend_library_writable 0.0" in http.get("/v1/metrics").text
    assert http.delete(f"/v1/shapes/{first}").status_code == 204
    assert http.delete(running).json()["state"] == "cancelled"
    other.unlink()
    until(lambda: http.get("/v1/readyz").status_code == 200)
    assert ended(http, post_mesh(http, small_mesh(2), parameters=FEW))["state"] == "succeeded"


def test_an_upload_fails_with_a_clear_error_when_the_temporary_folder_is_full(tmp_path):
    folder = tmp_path / "temporary"
    folder.mkdir()
    large = {"files": {"file": ("m.ply", bytes(6 * 2**20))}}
    try:
        with (
            small_disk(folder, 4),
            Server(tmp_path, workers=1, ready=False, temporary=folder) as server,
            server.http() as http,
        ):
            for path in ("/v1/shapes", "/v1/queries"):
                problem = check(http.post(path, **large), 507, "temporary_full")
                assert "temporary files" in problem["detail"]
            assert http.get("/v1/livez").status_code == 200
    except PermissionError:
        pytest.skip("only root can mount a disk of its own")


def test_a_long_job_updates_its_progress_at_least_every_five_seconds(tmp_path):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        url = post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS)).headers["Location"]
        seen: list[float] = []
        end = time.monotonic() + PATIENCE
        while len(set(seen)) < 6:
            assert time.monotonic() < end
            job = http.get(url).json()
            if "seconds" in job["detail"]:
                seen.append(job["detail"]["seconds"])
            time.sleep(0.1)
        steps = sorted(set(seen))
        assert max(later - earlier for earlier, later in itertools.pairwise(steps)) < 5.0
        http.delete(url)
