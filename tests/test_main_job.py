"""The main use case with real meshes: import over HTTP, then retrieval on the stored shapes."""

from __future__ import annotations

import csv
import json
import subprocess
import sys

import pytest

from tests.support.server import Server, without_settings
from unbend import Client, Library


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "unbend", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, env=without_settings(), timeout=400)


def test_480_real_meshes_imported_over_http_are_classified_by_their_signatures(labelled, shared_data, tmp_path):
    listed = labelled("shrec11_simplified")
    with (tmp_path / "labels.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, ["path", "class"], extrasaction="ignore")
        writer.writeheader()
        writer.writerows(row for _, row in listed)
    with Server(tmp_path / "server") as server:
        done = run("import", str(shared_data), "--labels", str(tmp_path / "labels.csv"), "--url", server.url)
        assert done.stdout == "480 of 480 shapes imported: 480 new\n"
        answer = json.loads(run("query", str(listed[0][0]), "--url", server.url, "--json").stdout)
        assert answer["classes"][0]["label"] == listed[0][1]["class"]
        with Client(server.url) as client:
            assert client.labels() == dict.fromkeys(sorted({row["class"] for _, row in listed}), 16)
            stored = next(client.iter_shapes(label="alien"))
            assert [match.label for match in client.nearest(stored.id, k=5)] == ["alien"] * 5
    with Library(str(server.library)) as library:
        figures = {name: library.evaluate(name) for name in ("moments", "surface_moments", "spectrum")}
    # The paper's Fig. 8 in numbers: moments of signatures, and the same moments of the original surfaces.
    assert figures["moments"].nn >= 0.95
    assert figures["surface_moments"].nn < 0.6 * figures["moments"].nn
    spectrum = figures["spectrum"]
    assert spectrum.nn == 1.0
    assert spectrum.ft >= 0.975
    assert spectrum.st >= 0.995
    assert spectrum.dcg >= 0.997


@pytest.mark.parametrize("dataset", ["dirty", "single"])
def test_every_damaged_real_mesh_becomes_a_shape(labelled, dataset, tmp_path):
    with Server(tmp_path / "server") as server, Client(server.url) as client:
        jobs = [client.submit(path, parameters={"samples": 60}) for path, _ in labelled(dataset)]
        ended = [job.wait(300) for job in jobs]
    assert all(job.state == "succeeded" for job in ended), [job.error for job in ended]
