"""Uses a server in every way that computes something: a job, a file, a picture, a ranking of each kind."""

from __future__ import annotations

import itertools
import json
from typing import get_args

import httpx
import numpy as np

from tests.support.server import ended, ply, stored, two_rings
from unbend import Surface
from unbend.correspondence.match import Turn
from unbend.library.requests import RANKING_MEASURES
from unbend.library.search.overview import MapDistance
from unbend.matching.classification import CLASSIFIERS
from unbend.mesh.formats import WRITTEN
from unbend.mesh.shapes import cylinder, figure, torus
from unbend.mesh.write import write_mesh
from unbend.render.request import Subject

SAMPLES = {"samples": 60}


def use_each_kind(http: httpx.Client) -> int:
    """Make a job of each kind, and each file of shapes; return the number of shapes, rankings and files."""
    shapes = [*_shapes(http), *_files(http)]
    made = len(shapes)
    for number, path in enumerate(_paths(shapes)):
        got = http.get(path, headers={"Prefer": "respond-async"} if number % 2 else {})
        if got.status_code == httpx.codes.ACCEPTED:
            got = http.get(f"/v1/jobs/{_succeeded(http, got)}/file")
        assert got.is_success, (path, got.text)
        made += 1
    for turn, other in itertools.product(get_args(Turn), (shapes[1], shapes[3])):
        wanted = {"a": shapes[0], "b": other, "orientation": turn, "part": "no", "samples": 40}
        _succeeded(http, http.post("/v1/matches", json=wanted))
        made += 1
    mesh = ply(figure("quadruped", 5, resolution=1500))
    for measure, classifier in itertools.product(RANKING_MEASURES, CLASSIFIERS):
        fields = {"measure": measure, "classifier": classifier, "k": "3", "parameters": json.dumps(SAMPLES)}
        queried = http.post(
            "/v1/queries", files={"file": ("mesh.ply", mesh)}, data=fields, headers={"Prefer": "wait=60"}
        )
        assert queried.is_success or classifier != "nearest", queried.text  # parts have one classifier
        made += queried.is_success
    return made


def _shapes(http: httpx.Client) -> list[str]:
    """Upload two labelled shapes of each of three classes, and a piece of the first."""
    classes = {
        "figure": [figure("quadruped", pose, resolution=1500) for pose in (0, 3)],
        "ring": [torus(minor=minor, columns=16, rows=9) for minor in (0.3, 0.35)],
        "sheet": [cylinder(angle, columns=12, rows=8) for angle in (1.0, 2.0)],
    }
    return [_upload(http, ply(surface), label=label) for label, surfaces in classes.items() for surface in surfaces]


def _files(http: httpx.Client) -> list[str]:
    """Upload files of each format, files with defects, and files that a policy changes."""
    whole = torus(columns=20, rows=10)
    corners = whole.vertices[whole.faces]
    soup = write_mesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3), "obj")
    thin = Surface(whole.vertices * [1.0, 1.0, 0.01], whole.faces)
    found = [
        _upload(http, write_mesh(whole.vertices, whole.faces, file_type), f"mesh.{file_type}") for file_type in WRITTEN
    ]
    return [
        *found,
        _upload(http, _stl(corners), "mesh.stl"),
        _upload(http, soup, "mesh.obj"),
        _upload(http, ply(thin)),
        _upload(http, ply(two_rings(1)), policy=json.dumps({"components": "bridge", "smooth": 3})),
        _upload(http, ply(figure("hand", 1, resolution=1500)), policy=json.dumps({"max_vertices": 200})),
    ]


def _stl(corners: np.ndarray) -> bytes:
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("", "<u2")])
    facets["corners"] = corners
    return bytes(80) + len(corners).to_bytes(4, "little") + facets.tobytes()


def _upload(http: httpx.Client, data: bytes, file_name: str = "mesh.ply", **fields: str) -> str:
    fields.setdefault("parameters", json.dumps(SAMPLES))
    return stored(http, data, file_name=file_name, **fields)["id"]


def _succeeded(http: httpx.Client, response: httpx.Response) -> str:
    job = ended(http, response)
    assert job["state"] == "succeeded", job
    return job["id"]


def _paths(shapes: list[str]) -> list[str]:
    """Return the addresses of all that is computed from stored shapes."""
    parameters = json.dumps(SAMPLES)
    found = [f"/v1/map?distance={distance}&parameters={parameters}" for distance in get_args(MapDistance)]
    found.append(f"/v1/evaluation?parameters={parameters}")
    for shape in shapes[0], shapes[4]:
        own = f"/v1/shapes/{shape}"
        found += [f"{own}/mesh?format={file_type}" for file_type in ("glb", "json") for _ in range(2)]
        found += [f"{own}/signature?format={file_type}&whole=true" for file_type in ("ply", "npz") for _ in range(2)]
        found += [f"{own}/flattening?format={file_type}" for file_type in ("obj", "glb")]
        found += [f"{own}/geodesics?source=0&target=30&update={update}" for update in ("planar", "spherical")]
        found += [f"{own}/geodesics?source=0&format=f32", f"{own}/view", f"{own}/view?faces=100"]
        found += [f"{own}/thumbnail?subject={subject}" for subject in get_args(Subject)]
    return found
