"""The files of `mesh_cases` over HTTP: each is stored with its area, or refused with its message."""

from __future__ import annotations

import pytest

from tests.support.mesh_cases import AREAS, CASES, REFUSED, surface_area_of
from tests.support.server import ended, post_mesh


@pytest.fixture(scope="module")
def http(server):
    with server.http() as client:
        yield client


def test_every_valid_mesh_file_is_stored_with_its_area(http):
    posted = {name: post_mesh(http, (CASES / name).read_bytes(), parameters='{"samples": 4}') for name in AREAS}
    for name, answer in posted.items():
        job = ended(http, answer)
        assert job["state"] == "succeeded", (name, job["error"])
        shape = http.get(f"/v1/shapes/{job['shape_id']}").json()
        assert shape["area"] == pytest.approx(surface_area_of(name), rel=1e-4), name


@pytest.mark.parametrize("name", REFUSED)
def test_every_unreadable_mesh_file_is_refused_with_its_message(http, name):
    answer = post_mesh(http, (CASES / name).read_bytes())
    assert answer.status_code == 415
    assert REFUSED[name] in answer.json()["detail"]
