"""Matches of stored shapes over HTTP."""

from __future__ import annotations

import asyncio
import io

import numpy as np
import pytest

from tests.support.server import ended, ply, stored
from unbend import AsyncClient, Client, Surface, match, read_mesh, transfer
from unbend.mesh.shapes import ellipsoid
from unbend.results import PointMap

OWN = '{"samples": 20}'


def egg(height: float) -> bytes:
    body = ellipsoid((1.0, 0.7, 0.4), subdivisions=2)
    bumps = 1 + height * np.exp(-((body.vertices - (0.9, 0.2, 0.1)) ** 2).sum(axis=1) / 0.1)
    return ply(Surface(body.vertices * bumps[:, None], body.faces))


@pytest.fixture(scope="module")
def http(server):
    with server.http() as client:
        yield client


@pytest.fixture(scope="module")
def ids(http):
    return [stored(http, egg(height), name=f"egg {height}", parameters=OWN)["id"] for height in (0.5, 0.4)]


def test_a_match_is_a_job_that_makes_a_file(http, ids):
    response = http.post("/v1/matches", json={"a": ids[0], "b": ids[1], "samples": 60, "format": "npz"})
    assert response.status_code == 202
    job = ended(http, response)
    assert (job["kind"], job["state"]) == ("file", "succeeded")
    assert response.headers["location"] == f"/v1/jobs/{job['id']}"
    file = http.get(f"/v1/jobs/{job['id']}/file")
    assert "egg_0.5-egg_0.4.npz" in file.headers["content-disposition"]
    a, b = read_mesh(egg(0.5)), read_mesh(egg(0.4))
    found = match(a, b, samples=60)
    with np.load(io.BytesIO(file.content)) as arrays:
        assert np.array_equal(arrays["corners"], b.faces[found.faces])
        assert arrays["barycentric"] == pytest.approx(found.barycentric)
        assert arrays["residual"] == found.residual


def test_a_repeated_match_is_the_same_job(http, ids):
    wanted, name = {"a": ids[0], "b": ids[1], "samples": 60}, {"Idempotency-Key": "match-once"}
    first = http.post("/v1/matches", json=wanted, headers=name).json()
    assert http.post("/v1/matches", json=wanted, headers=name).json()["id"] == first["id"]
    assert http.post("/v1/matches", json=wanted).json()["id"] != first["id"]
    other = http.post("/v1/matches", json=wanted | {"samples": 50}, headers=name)
    assert (other.status_code, other.json()["code"]) == (409, "idempotency_mismatch")


def test_a_match_may_be_a_coloured_mesh(http, ids):
    job = ended(http, http.post("/v1/matches", json={"a": ids[0], "b": ids[1], "samples": 60, "format": "ply"}))
    surface = read_mesh(http.get(f"/v1/jobs/{job['id']}/file").content)
    assert len(surface.vertices) == len(read_mesh(egg(0.5)).vertices)


def test_both_clients_return_the_points(server, ids):
    with Client(server.url) as client:
        points = client.match(*ids, samples=60)
    b = read_mesh(egg(0.4))
    places = np.einsum("nc,nck->nk", points.barycentric, b.vertices[points.corners])
    assert places == pytest.approx(transfer(match(read_mesh(egg(0.5)), b, samples=60), b.vertices))

    async def ask() -> PointMap:
        async with AsyncClient(server.url) as client:
            return await client.match(*ids, samples=60, orientation="reverse")

    assert not np.array_equal(asyncio.run(ask()).corners, points.corners)


def test_a_piece_is_matched_to_its_whole(http, ids):
    body = read_mesh(egg(0.5))
    kept = body.faces[(body.vertices[body.faces] @ (0.5, 0.7, 0.3)).mean(axis=1) > -0.1]
    used, corners = np.unique(kept, return_inverse=True)
    part = Surface(body.vertices[used], corners.reshape(-1, 3))
    stored_id = stored(http, ply(part), name="piece", parameters=OWN)["id"]
    job = ended(http, http.post("/v1/matches", json={"a": stored_id, "b": ids[0], "samples": 60}))
    points = http.get(f"/v1/jobs/{job['id']}/file").json()
    assert points["confidence"] == pytest.approx(match(part, body, samples=60).confidence)
    refused = ended(http, http.post("/v1/matches", json={"a": ids[0], "b": stored_id, "samples": 60}))
    assert refused["state"] == "failed"
    assert "the piece first" in refused["error"]["message"]


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({"b": "00000000-0000-0000-0000-000000000000"}, 404),
        ({"samples": 5}, 422),
        ({"orientation": "left"}, 422),
        ({"part": "b"}, 422),
        ({"format": "stl"}, 422),
        ({"colour": "red"}, 422),
        ({"b": None}, 422),
    ],
)
def test_what_cannot_be_matched_is_refused(http, ids, changes, status):
    response = http.post("/v1/matches", json={"a": ids[0], "b": ids[1]} | changes)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"


def test_a_surface_without_sides_is_matched_and_says_so(http, ids):
    body = read_mesh(egg(0.5))
    faces = body.faces.copy()
    faces[::4] = faces[::4, ::-1]
    mixed = stored(http, ply(Surface(body.vertices, faces)), name="mixed", parameters=OWN)["id"]
    job = ended(http, http.post("/v1/matches", json={"a": mixed, "b": ids[0], "samples": 60}))
    assert http.get(f"/v1/jobs/{job['id']}/file").json()["oriented"] is False
