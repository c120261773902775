"""Shapes over HTTP on a real server: upload, read, change, download, remove."""

from __future__ import annotations

import io
import json
import re
import uuid

import numpy as np
import pytest

from tests.support.server import DAMAGED, SAMPLES, ended, ply, post_mesh, small_mesh, stored, two_rings
from unbend import MeshPolicy, Parameters, canonical_form, compute_signature, geodesic_distances, read_mesh
from unbend.mesh.shapes import cylinder, sheet, tetrahedron

FEW = json.dumps(SAMPLES)
MEDIA_TYPES = {
    "json": "application/json",
    "ply": "application/vnd.ply",
    "obj": "model/obj",
    "off": "model/vnd.off",
    "glb": "model/gltf-binary",
    "npz": "application/vnd.numpy.npz",
}
RECORD = {
    "id", "name", "label", "metadata", "sha256", "size", "parameters", "policy", "version", "area", "stress",
    "dimension", "report", "warnings", "created_at", "updated_at", "revision", "seq",
}  # fmt: skip
JOB = {
    "id", "kind", "state", "stage", "progress", "position", "attempts", "detail", "error", "shape_id", "result",
    "created_at", "started_at", "finished_at", "warnings", "ignored",
}  # fmt: skip


@pytest.fixture(scope="module")
def http(server):
    with server.http() as client:
        yield client


@pytest.fixture(scope="module")
def ring(http):
    """A stored torus."""
    return stored(http, small_mesh(200), name="ring", label="torus", parameters=FEW)


def test_an_upload_becomes_a_shape_and_a_repeated_upload_returns_that_shape(http):
    label = uuid.uuid4().hex
    fields = {"name": "ring", "label": label, "metadata": '{"n": [1, null]}', "parameters": FEW}
    data = small_mesh(201)
    response = post_mesh(http, data, **fields)
    assert response.status_code == 202
    accepted = response.json()
    assert set(accepted) == JOB
    assert response.headers["Location"] == f"/v1/jobs/{accepted['id']}"
    assert (accepted["kind"], accepted["state"], accepted["shape_id"]) == ("shape", "queued", None)
    job = ended(http, response)
    assert set(job) == JOB
    assert (job["state"], job["progress"], job["position"], job["error"]) == ("succeeded", 1.0, None, None)
    shape = http.get(f"/v1/shapes/{job['shape_id']}").json()
    assert set(shape) == RECORD
    assert (shape["name"], shape["label"], shape["metadata"]) == ("ring", label, {"n": [1, None]})
    assert (shape["size"], shape["parameters"]) == (len(data), Parameters(**SAMPLES).as_dict())
    assert shape["policy"] == MeshPolicy().as_dict()
    again = post_mesh(http, data, **fields)
    assert again.status_code == 200
    assert again.json() == shape | {"ignored": [], "updated": []}


def test_every_parameter_can_be_set_and_the_record_has_the_dimension(http):
    chosen = {
        "samples": "auto", "tolerance": 0.2, "dimensions": "auto", "criterion": "stress", "threshold": 0.01,
        "starts": 2, "seed": 7, "weights": "inverse", "first_sample": "random", "update": "planar", "scaling": "box",
    }  # fmt: skip
    data = small_mesh(202)
    job = ended(http, post_mesh(http, data, parameters=json.dumps(chosen)))
    shape = http.get(f"/v1/shapes/{job['shape_id']}").json()
    expected = compute_signature(read_mesh(data), Parameters(**chosen))
    assert shape["parameters"] == Parameters(**chosen).as_dict()
    assert (shape["dimension"], shape["stress"]) == (expected.dimension, pytest.approx(expected.stress))
    reported = http.get(f"/v1/shapes/{shape['id']}/descriptors").json()["descriptors"]["dimension"]
    assert reported[0] == expected.dimension
    np.testing.assert_allclose(reported[1:], expected.representation_errors)


def test_a_damaged_mesh_becomes_a_failed_job_with_a_code_and_advice(http):
    job = ended(http, post_mesh(http, DAMAGED + b"# over http", file_name="x.off"))
    assert (job["state"], job["shape_id"], job["result"]) == ("failed", None, None)
    assert set(job["error"]) == {"code", "message", "advice"}
    assert job["error"]["code"] == "mesh_read"
    assert "ends early" in job["error"]["message"]


@pytest.mark.parametrize(
    ("number", "file_name", "name"),
    [
        (300, "../../etc/passwd.off", "passwd"),
        (301, "..\\..\\windows\\system.ini.off", "system.ini"),
        (302, "/absolute/päth ☃.off", "päth ☃"),
        (303, "quote's;.off", "quote's;"),
        (304, "..", ".."),
        (305, ".off", ".off"),
    ],
)
def test_a_file_name_becomes_a_name_without_its_folders(server, http, number, file_name, name):
    shape = stored(http, small_mesh(number), file_name=file_name, parameters=FEW)
    assert shape["name"] == name
    assert {path.name for path in server.library.parent.iterdir()} <= {
        "server.log", "library.db", "library.db-wal", "temporary", "library.db-shm",
        "library.db-lease", "library.db-reserve",
    }  # fmt: skip
    download = http.get(f"/v1/shapes/{shape['id']}/mesh")
    assert download.content == small_mesh(number)
    plain = re.match(
        r'attachment; filename="([^"]*)"; filename\*=UTF-8\'\'([^;"/\\]*)$', download.headers["content-disposition"]
    )
    assert plain
    assert "/" not in plain[1]
    assert "\\" not in plain[1]


def test_the_pages_of_a_label_contain_every_shape_once(http):
    label = uuid.uuid4().hex
    ids = [stored(http, small_mesh(210 + number), label=label, parameters=FEW)["id"] for number in range(5)]
    seen, cursor = [], None
    while True:
        params = {"label": label, "limit": 2} | ({"cursor": cursor} if cursor else {})
        page = http.get("/v1/shapes", params=params).raise_for_status().json()
        assert set(page) == {"items", "next_cursor"}
        assert len(page["items"]) <= 2
        seen += [item["id"] for item in page["items"]]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert sorted(seen) == sorted(ids)
    assert len(seen) == 5
    everything = http.get("/v1/shapes", params={"limit": 500}).json()["items"]
    assert [item["id"] for item in everything if item["label"] == label] == seen
    assert http.get("/v1/classes").json()["items"].count({"label": label, "count": 5}) == 1


def test_name_label_and_metadata_can_be_changed(http):
    shape = stored(http, small_mesh(220), name="a", label="b", metadata='{"c": 1}', parameters=FEW)
    url = f"/v1/shapes/{shape['id']}"
    changed = http.patch(url, json={"label": None, "metadata": {"d": 2}})
    assert changed.status_code == 200
    stamps = {name: changed.json()[name] for name in ("updated_at", "revision")}
    edited = {"label": None, "metadata": {"d": 2}, **stamps}
    assert stamps["revision"] > shape["revision"]
    assert changed.json() == shape | edited
    assert http.get(url).json() == changed.json()
    assert http.patch(url, json={}).json() == changed.json()
    for wrong in ({"name": None}, {"name": ""}, {"label": "x" * 201}, {"sha256": "0"}, {"metadata": [1]}, [], "x"):
        assert http.patch(url, json=wrong).status_code == 422, wrong
    assert http.get(url).json() == changed.json()


def test_every_resource_of_a_removed_shape_is_not_found(http):
    shape = stored(http, small_mesh(221), parameters=FEW)
    url = f"/v1/shapes/{shape['id']}"
    response = http.delete(url)
    assert (response.status_code, response.content) == (204, b"")
    for method, path in (
        ("GET", ""), ("DELETE", ""), ("GET", "/mesh"), ("GET", "/mesh?format=off"), ("GET", "/signature"),
        ("GET", "/descriptors"), ("GET", "/geodesics?source=0"),
    ):  # fmt: skip
        gone = http.request(method, url + path)
        assert (gone.status_code, gone.json()["code"]) == (404, "not_found"), path
    assert http.patch(url, json={"name": "x"}).status_code == 404
    assert http.post("/v1/queries", json={"shape_id": shape["id"]}).status_code == 404
    assert post_mesh(http, small_mesh(221), parameters=FEW).status_code == 202  # the file is new to the library


def test_an_uploaded_mesh_is_returned_byte_for_byte(http, ring):
    for headers in ({}, {"Accept": "*/*"}, {"Accept": "application/octet-stream"}, {"Accept": "application/vnd.ply"}):
        response = http.get(f"/v1/shapes/{ring['id']}/mesh", headers=headers)
        assert response.content == small_mesh(200)
        assert response.headers["content-type"] == "application/vnd.ply"
        assert response.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("file_type", ["ply", "obj", "off", "glb", "json", "npz"])
def test_a_mesh_is_converted_by_format_and_by_accept(http, ring, file_type):
    url = f"/v1/shapes/{ring['id']}/mesh"
    by_format = http.get(url, params={"format": file_type})
    by_accept = http.get(url, headers={"Accept": f"text/html, {MEDIA_TYPES[file_type]};q=0.9"})
    for response in (by_format, by_accept):
        assert response.status_code == 200
        assert response.headers["content-type"] == MEDIA_TYPES[file_type]
        assert response.headers["content-disposition"].startswith(f'attachment; filename="ring.{file_type}"')
    if file_type != "npz":  # a zip file contains the time of its creation
        assert by_accept.content == by_format.content
    expected = read_mesh(small_mesh(200))
    vertices, faces = arrays(by_format.content, file_type)
    np.testing.assert_allclose(vertices, expected.vertices, atol=1e-6)
    assert len(faces) == len(expected.faces)


def arrays(data: bytes, file_type: str) -> tuple[np.ndarray, np.ndarray]:
    if file_type == "json":
        reported = json.loads(data)
        return np.array(reported["vertices"]), np.array(reported["faces"])
    if file_type == "npz":
        with np.load(io.BytesIO(data)) as file:
            return file["vertices"], file["faces"]
    surface = read_mesh(data)
    return surface.vertices, surface.faces


@pytest.mark.parametrize("part", ["mesh", "signature"])
def test_an_unsupported_format_is_refused(http, ring, part):
    url = f"/v1/shapes/{ring['id']}/{part}"
    for accept in ("text/html", "image/png, text/plain", "model/stl"):
        response = http.get(url, headers={"Accept": accept})
        assert (response.status_code, response.json()["status"]) == (406, 406), accept
    assert http.get(url, params={"format": "step"}).status_code == 422


@pytest.mark.parametrize("file_type", MEDIA_TYPES)
def test_the_canonical_form_of_all_vertices_is_served_in_every_format(http, ring, file_type):
    expected = canonical_form(read_mesh(small_mesh(200)), Parameters(**SAMPLES)).points
    response = http.get(f"/v1/shapes/{ring['id']}/signature", params={"format": file_type, "whole": True})
    assert response.status_code == 200
    assert 'filename="ring-form.' in response.headers["content-disposition"]
    if file_type == "json":
        points = np.array(response.json()["points"])
    elif file_type == "npz":
        with np.load(io.BytesIO(response.content)) as file:
            points = file["points"]
    else:
        points = arrays(response.content, file_type)[0]
    np.testing.assert_allclose(points, expected, atol=1e-6)


def test_a_flattened_sheet_has_its_vertices_and_texture_coordinates(http):
    surface = cylinder(columns=12, rows=6)
    shape = stored(http, ply(surface), name="roll", parameters=FEW)
    url = f"/v1/shapes/{shape['id']}/flattening"
    with np.load(io.BytesIO(http.get(url, params={"format": "npz"}).content)) as file:
        np.testing.assert_allclose(file["vertices"], surface.vertices, atol=1e-6)
        np.testing.assert_allclose(np.ptp(file["uv"], axis=0).max(), 1.0)
    text = http.get(url).raise_for_status()
    assert text.headers["content-type"] == MEDIA_TYPES["obj"]
    assert text.text.count("\nvt ") == len(surface.vertices)
    assert http.get(url, params={"format": "ply"}).status_code == 422
    assert http.get(url, headers={"Accept": MEDIA_TYPES["ply"]}).status_code == 406


def test_an_stl_file_is_returned_unchanged_and_can_be_converted(http):
    import trimesh

    surface = tetrahedron(3.0)
    data = trimesh.Trimesh(surface.vertices, surface.faces, process=False).export(file_type="stl")
    shape = stored(http, data, file_name="x.stl", parameters=FEW)
    url = f"/v1/shapes/{shape['id']}/mesh"
    assert http.get(url).content == data
    assert http.get(url).headers["content-type"] == "model/stl"
    assert len(read_mesh(http.get(url, params={"format": "off"}).content).vertices) == 4


def test_a_mesh_whose_format_is_known_only_by_its_file_name_is_served(http):
    facets = []
    surface = tetrahedron()
    for face in surface.faces:
        corners = "\n".join(
            "vertex " + " ".join(f"{value:.6f}" for value in surface.vertices[corner]) for corner in face
        )
        facets.append(f"facet normal 0 0 0\nouter loop\n{corners}\nendloop\nendfacet\n")
    data = f"solid {'x' * 5000}\n{''.join(facets)}endsolid\n".encode()
    shape = stored(http, data, file_name="long.stl", parameters=FEW)
    assert http.get(f"/v1/shapes/{shape['id']}/mesh", params={"format": "off"}).status_code == 200
    assert http.get(f"/v1/shapes/{shape['id']}/geodesics", params={"source": 0}).status_code == 200


@pytest.mark.parametrize("file_type", MEDIA_TYPES)
def test_a_signature_is_served_in_every_format(http, ring, file_type):
    url = f"/v1/shapes/{ring['id']}/signature"
    expected = compute_signature(read_mesh(small_mesh(200)), Parameters(**SAMPLES))
    for response in (
        http.get(url, params={"format": file_type}), http.get(url, headers={"Accept": MEDIA_TYPES[file_type]}),
    ):  # fmt: skip
        assert response.status_code == 200
        assert response.headers["content-type"] == MEDIA_TYPES[file_type]
        if file_type == "json":
            points = response.json()["points"]
            assert response.json()["parameters"] == expected.parameters.as_dict()
        elif file_type == "npz":
            with np.load(io.BytesIO(response.content)) as file:
                points = file["points"]
        else:
            points = read_mesh(response.content).vertices
        np.testing.assert_allclose(points, expected.points, atol=1e-6)
    assert http.get(url).json()["samples"] == expected.samples.tolist()


def test_descriptors_equal_those_of_the_signature(http, ring):
    reported = http.get(f"/v1/shapes/{ring['id']}/descriptors").json()["descriptors"]
    expected = compute_signature(read_mesh(small_mesh(200)), Parameters(**SAMPLES)).descriptors
    assert set(reported) == {"spectrum", "moments", "distribution", "dimension", "reeb", "surface_moments"}
    for name, vector in reported.items():
        np.testing.assert_allclose(vector, expected[name], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("update", ["spherical", "planar"])
def test_geodesics_are_the_distances_from_a_vertex(http, ring, update):
    url = f"/v1/shapes/{ring['id']}/geodesics"
    reported = http.get(url, params={"source": 7, "update": update}).json()
    assert reported["source"] == 7
    expected = geodesic_distances(read_mesh(small_mesh(200)), 7, update=update)[0]
    np.testing.assert_allclose(reported["distances"], expected)
    assert reported["distances"][7] == 0


def test_geodesics_to_a_target_include_the_shortest_path(http, ring):
    url = f"/v1/shapes/{ring['id']}/geodesics"
    answer = http.get(url, params={"source": 0, "target": 30}).json()
    path = np.array(answer["path"])
    assert answer["target"] == 30
    np.testing.assert_allclose(np.linalg.norm(np.diff(path, axis=0), axis=1).sum(), answer["distances"][30], rtol=0.02)
    problem = http.get(url, params={"source": 0, "target": 999_999})
    assert problem.status_code == 409
    assert "999999" in problem.json()["detail"]


def test_distances_to_unreachable_vertices_are_null(http):
    surface = sheet(columns=3, rows=2)
    corners = [" ".join(map(str, vertex)) for vertex in [*surface.vertices.tolist(), [9, 9, 9]]]
    faces = ["3 " + " ".join(map(str, face)) for face in surface.faces.tolist()]
    data = "\n".join([f"OFF {len(corners)} {len(faces)} 0", *corners, *faces]).encode()
    shape = stored(http, data, parameters=FEW)
    url = f"/v1/shapes/{shape['id']}/geodesics"
    distances = http.get(url, params={"source": 0}).json()["distances"]
    assert len(distances) == len(corners)
    assert distances[-1] is None
    assert None not in distances[:-1]


def test_geodesics_from_an_invalid_vertex_are_refused(http, ring):
    url = f"/v1/shapes/{ring['id']}/geodesics"
    for params in ({}, {"source": -1}, {"source": 2**40}, {"source": 0, "update": "straight"}):
        assert http.get(url, params=params).status_code == 422, params
    assert http.get(url, params={"source": 60}).status_code == 409


def test_a_mesh_read_by_two_policies_becomes_two_shapes(http):
    data = ply(two_rings(0))
    largest = stored(http, data, parameters=FEW)
    bridged = stored(http, data, parameters=FEW, policy='{"components": "bridge"}')
    assert largest["policy"] == {"components": "largest", "max_vertices": None, "smooth": 0, "seams": "stitch"}
    assert bridged["policy"] == largest["policy"] | {"components": "bridge"}
    assert bridged["sha256"] == largest["sha256"]
    assert bridged["report"]["links"] == 1
    expected = [read_mesh(data, policy=MeshPolicy(components=kind)) for kind in ("largest", "bridge")]
    assert [largest["area"], bridged["area"]] == [surface.area for surface in expected]
    for shape, policy in ((largest, ""), (largest, "{}"), (bridged, '{"max_vertices":null,"components":"bridge"}')):
        again = post_mesh(http, data, parameters=FEW, policy=policy)
        assert (again.status_code, again.json()["id"]) == (200, shape["id"]), policy
    faces = [
        len(http.get(f"/v1/shapes/{shape['id']}/mesh", params={"format": "json"}).json()["faces"])
        for shape in (largest, bridged)
    ]
    assert faces == [len(surface.faces) for surface in expected]
    answer = http.get(f"/v1/shapes/{bridged['id']}/geodesics", params={"source": 0, "target": 77}).json()
    assert None not in answer["distances"]
    assert len(answer["path"]) > 1
    assert http.get(f"/v1/shapes/{largest['id']}/geodesics", params={"source": 0}).json()["distances"][60] is None


def test_geodesics_of_a_simplified_mesh_refer_to_the_vertices_of_its_file(http):
    surface, left, count = two_rings(0, columns=100, rows=20), 2000, 2018
    data = ply(surface)
    shape = stored(http, data, parameters=FEW, policy='{"max_vertices": 1000}')
    assert 900 < shape["report"]["simplified_vertices"] <= 1000
    url = f"/v1/shapes/{shape['id']}"
    assert len(http.get(f"{url}/mesh", params={"format": "json"}).json()["vertices"]) <= 1000
    assert http.get(f"{url}/mesh").content == data
    source, target = 1945, 1010
    answer = http.get(f"{url}/geodesics", params={"source": source, "target": target}).json()
    assert (answer["source"], answer["target"]) == (source, target)
    assert len(answer["distances"]) == count
    assert answer["distances"][left:] == [None] * (count - left)
    actual, expected = np.array(answer["distances"][:left]), geodesic_distances(surface, source)[0][:left]
    assert actual[source] == 0
    errors = np.abs(actual - expected) / expected.max()
    assert errors.mean() < 0.02
    assert errors.max() < 0.06
    path = np.array(answer["path"])
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert length == pytest.approx(actual[target], rel=0.03)
    ends = np.linalg.norm(path[[0, -1]] - surface.vertices[[source, target]], axis=1)
    assert ends.max() < 0.05 * expected.max()


def test_geodesics_of_a_vertex_lost_in_simplification_are_refused(http):
    shape = stored(http, ply(two_rings(1)), parameters=FEW, policy='{"max_vertices": 40}')
    url = f"/v1/shapes/{shape['id']}/geodesics"
    for params, name in (({"source": 70}, "source"), ({"source": 0, "target": 70}, "target")):
        response = http.get(url, params=params)
        assert (response.status_code, response.json()["code"]) == (409, "unsuited")
        assert response.json()["detail"] == f"{name}: vertex 70 was removed when the mesh was simplified"
    problem = http.get(url, params={"source": 78})
    assert (problem.status_code, problem.json()["detail"]) == (409, "source: the mesh has no vertex 78, only 0 to 77")


@pytest.mark.parametrize(
    "metadata",
    ['{"a": NaN}', '{"a": Infinity}', '{"a": 1e999}', '{"a": "\\ud800"}', '{"a":' * 60_000, "[" * 60_000],
    ids=["nan", "infinity", "overflow", "half a character", "deep", "deep list"],
)
def test_metadata_that_is_not_valid_json_is_refused_on_upload(http, metadata):
    response = post_mesh(http, small_mesh(230), metadata=metadata, parameters=FEW)
    if response.status_code == 202:  # on a failure, clean up for the tests that follow
        job = ended(http, response)
        listed = http.get("/v1/shapes", params={"limit": 500}).status_code
        http.delete(f"/v1/shapes/{job['shape_id']}")
        assert listed == 200
    assert response.status_code == 422, response.text


@pytest.mark.parametrize(
    "body", ['{"metadata": {"a": NaN}}', '{"metadata": {"a": Infinity}}', '{"metadata": {"a": "\\ud800"}}']
)
def test_metadata_that_is_not_valid_json_is_refused_in_a_change(http, body):
    shape = stored(http, small_mesh(231), parameters=FEW)
    url = f"/v1/shapes/{shape['id']}"
    response = http.patch(url, content=body, headers={"Content-Type": "application/json"})
    if response.status_code != 422:
        http.patch(url, json={"metadata": {}})
    assert response.status_code == 422, response.text


def test_a_name_from_a_file_has_at_most_200_characters(http):
    shape = stored(http, small_mesh(232), file_name="x" * 300 + ".ply", parameters=FEW)
    assert len(shape["name"]) <= 200
