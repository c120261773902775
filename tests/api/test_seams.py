"""Meshes with seams, and meshes of which only a part is kept, over HTTP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.server import ended, post_mesh, stored
from unbend import read_mesh
from unbend.mesh.shapes import sphere
from unbend.mesh.write import write_mesh

FLAT_CUBE = (Path(__file__).parents[1] / "mesh" / "cases" / "ply_flat_cube_24.ply").read_bytes()
FEW = '{"samples": 8}'


@pytest.fixture(scope="module")
def http(server):
    with server.http() as client:
        yield client


def halves() -> bytes:
    """Return two disconnected spheres of equal size."""
    ball = sphere(1)
    vertices = np.concatenate([ball.vertices, ball.vertices + 3.25])
    return write_mesh(vertices, np.concatenate([ball.faces, ball.faces + len(ball.vertices)]), "ply")


def test_all_copies_of_a_split_vertex_have_equal_distances(http):
    shape = stored(http, FLAT_CUBE, parameters=FEW)
    assert (shape["report"]["vertices"], shape["report"]["components"], shape["report"]["seams"]) == (24, 1, 12)
    assert shape["area"] == pytest.approx(52)
    url = f"/v1/shapes/{shape['id']}/geodesics"
    rows = [http.get(url, params={"source": vertex}).json()["distances"] for vertex in range(24)]
    where = read_mesh(FLAT_CUBE).vertex_map
    assert sorted(np.bincount(where).tolist()) == [3] * 8
    for vertex in range(24):
        copy = int(np.flatnonzero(where == where[vertex])[0])
        assert rows[vertex] == rows[copy]
        assert [row[vertex] for row in rows] == [row[copy] for row in rows]
        assert rows[vertex][copy] == 0.0
    path = http.get(url, params={"source": 0, "target": 23}).json()["path"]
    assert len(path) >= 2


def test_a_discarded_component_is_a_warning_of_the_shape_the_job_and_the_answer(http):
    job = ended(http, post_mesh(http, halves(), parameters=FEW))
    shape = http.get(f"/v1/shapes/{job['shape_id']}").json()
    (sentence,) = shape["warnings"]
    assert "50.0% of the area" in sentence
    assert 'components="bridge"' in sentence
    assert job["warnings"] == shape["warnings"] == shape["report"]["warnings"]
    assert shape in http.get("/v1/shapes", params={"limit": 500}).json()["items"]
    query = ended(http, http.post("/v1/queries", files={"file": ("a.ply", halves())}, data={"parameters": FEW}))
    assert query["warnings"] == query["result"]["warnings"] == [sentence]
    by_shape = http.post("/v1/queries", json={"shape_id": shape["id"]}).json()
    assert by_shape["warnings"] == [sentence]
    assert sentence in http.get(f"/v1/shapes/{shape['id']}/signature").json()["warnings"]


def test_a_mesh_kept_completely_has_no_warnings(http):
    job = ended(http, post_mesh(http, halves(), parameters=FEW, policy='{"components": "bridge"}'))
    assert job["warnings"] == []
    assert http.get(f"/v1/shapes/{job['shape_id']}").json()["warnings"] == []


def test_keeping_seams_keeps_one_side_of_the_box_with_a_warning(http):
    shape = stored(http, FLAT_CUBE, parameters='{"samples": 4}', policy='{"seams": "keep"}')
    assert shape["report"]["components"] == 6
    assert 'seams="stitch"' in shape["warnings"][0]
