"""Pictures, views, the demo, the stream of all jobs and the page over HTTP, on a real server."""

from __future__ import annotations

import io
import json
import struct
import threading

import httpx
import numpy as np
import pytest
from PIL import Image

from tests.support.server import SAMPLES, Server, ply, post_mesh, small_mesh, stored
from unbend import Parameters, canonical_form, compute_signature, geodesic_distances, read_mesh
from unbend.api.routes.page import FOLDER
from unbend.mesh.shapes import torus

FEW = json.dumps(SAMPLES)
FINE = ply(torus(columns=90, rows=60))


@pytest.fixture(scope="module")
def http(server):
    with server.http() as client:
        yield client


@pytest.fixture(scope="module")
def ring(http):
    return stored(http, small_mesh(700), name="ring", label="torus", parameters=FEW)


def read_glb(data):
    """The JSON of a glb file, and its arrays by name."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    (size,) = struct.unpack_from("<I", data, 12)
    gltf = json.loads(data[20 : 20 + size])
    begin = 20 + size + 8

    def array(number, kind):
        accessor = gltf["accessors"][number]
        view = gltf["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
        flat = np.frombuffer(data, kind, accessor["count"] * width, begin + view["byteOffset"])
        return flat.reshape(-1, width)

    primitive = gltf["meshes"][0]["primitives"][0]
    arrays = {name: array(number, "<f4") for name, number in primitive["attributes"].items()}
    return gltf, arrays | {"faces": array(primitive["indices"], "<u4").reshape(-1, 3)}


@pytest.mark.parametrize("file_type", ["png", "webp"])
@pytest.mark.parametrize("subject", ["surface", "signature", "both"])
def test_a_thumbnail_has_the_requested_subject_size_and_format(http, ring, subject, file_type):
    query = {"subject": subject, "width": 120, "height": 80, "format": file_type}
    response = http.get(f"/v1/shapes/{ring['id']}/thumbnail", params=query).raise_for_status()
    picture = Image.open(io.BytesIO(response.content))
    assert response.headers["content-type"] == f"image/{file_type}"
    assert (picture.size, picture.format) == ((120, 80), file_type.upper())
    shown = np.asarray(picture.convert("RGBA"))[..., 3] > 128
    assert 0.05 < shown.mean() < 0.95
    if subject == "both":
        assert shown[:, :60].any()
        assert shown[:, 60:].any()


def test_a_thumbnail_is_cached_by_its_etag_until_the_options_change(http, ring):
    path = f"/v1/shapes/{ring['id']}/thumbnail"
    first = http.get(path)
    assert first.headers["cache-control"] == "private, no-cache"
    again = http.get(path, headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    http.patch(f"/v1/shapes/{ring['id']}", json={"metadata": {"changed": True}}).raise_for_status()
    assert http.get(path, headers={"If-None-Match": first.headers["etag"]}).status_code == 304
    other = http.get(path, params={"width": 64}, headers={"If-None-Match": first.headers["etag"]})
    assert other.status_code == 200


@pytest.mark.parametrize("query", [{"width": 8}, {"height": 4096}, {"subject": "back"}, {"format": "gif"}, {"size": 3}])
def test_a_bad_thumbnail_is_refused(http, ring, query):
    response = http.get(f"/v1/shapes/{ring['id']}/thumbnail", params=query)
    assert response.status_code == 422
    assert response.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize("path", ["thumbnail", "view"])
def test_there_is_no_picture_of_an_unknown_shape(http, path):
    assert http.get(f"/v1/shapes/{'0' * 32}/{path}").status_code == 404


def test_a_view_has_the_surface_and_the_canonical_form(http, ring):
    gltf, arrays = read_glb(http.get(f"/v1/shapes/{ring['id']}/view").raise_for_status().content)
    surface = read_mesh(small_mesh(700))
    about = gltf["asset"]["extras"]
    assert (about["dimensions"], about["faces"], about["full_faces"]) == (3, len(surface.faces), len(surface.faces))
    numbers = arrays["_VERTEX"][:, 0].astype(int)
    assert arrays["POSITION"] + about["centre"] == pytest.approx(surface.vertices[numbers], abs=1e-6)
    signature = compute_signature(surface, Parameters(**SAMPLES))
    whole = canonical_form(surface, signature=signature).points * signature.scale
    expected = np.linalg.norm(whole[numbers][:, None] - whole[numbers], axis=2)
    found = np.linalg.norm(arrays["_FORM"][:, None] - arrays["_FORM"], axis=2)
    assert found == pytest.approx(expected, abs=1e-4)  # turned, but not deformed


def test_a_view_of_a_large_surface_is_simplified(http):
    shape = stored(http, FINE, name="fine", parameters=FEW)
    gltf, arrays = read_glb(http.get(f"/v1/shapes/{shape['id']}/view", params={"faces": 2000}).content)
    surface = read_mesh(FINE)
    assert gltf["asset"]["extras"]["full_faces"] == len(surface.faces) > len(arrays["faces"])
    assert len(arrays["faces"]) <= 2000
    numbers = arrays["_VERTEX"][:, 0].astype(int)
    assert len(set(numbers.tolist())) == len(numbers)
    assert arrays["POSITION"] + gltf["asset"]["extras"]["centre"] == pytest.approx(surface.vertices[numbers], abs=1e-6)
    # The form approximates the geodesic distances of the whole surface.
    distances = geodesic_distances(surface, int(numbers[0]))[0][numbers]
    straight = np.linalg.norm(arrays["_FORM"] - arrays["_FORM"][0], axis=1)
    assert np.corrcoef(distances, straight)[0, 1] > 0.9


def test_further_dimensions_are_an_attribute(http):
    shape = stored(http, small_mesh(701), parameters=json.dumps(SAMPLES | {"dimensions": 5}))
    gltf, arrays = read_glb(http.get(f"/v1/shapes/{shape['id']}/view").content)
    assert gltf["asset"]["extras"]["dimensions"] == 5
    assert np.abs(arrays["_MORE"][:, :2]).max() > 0
    assert not arrays["_MORE"][:, 2].any()


def test_a_file_is_viewed_without_being_stored(http):
    before = len(http.get("/v1/shapes", params={"limit": 500}).json()["items"])
    response = http.post("/v1/views", files={"file": ("ring.ply", small_mesh(702))}, data={"parameters": FEW})
    _, arrays = read_glb(response.raise_for_status().content)
    assert arrays["_FORM"].shape == arrays["POSITION"].shape == (60, 3)
    assert len(http.get("/v1/shapes", params={"limit": 500}).json()["items"]) == before


def test_a_damaged_file_has_no_view(http):
    response = http.post("/v1/views", files={"file": ("a.off", b"OFF\n4 4 0\n0 0 0\n")})
    assert response.status_code == 422
    assert http.post("/v1/views", files={"file": ("a.txt", b"no mesh at all")}).status_code == 415


def test_distances_as_floats_are_those_of_the_json(http, ring):
    path = f"/v1/shapes/{ring['id']}/geodesics"
    plain = http.get(path, params={"source": 3}).json()["distances"]
    response = http.get(path, params={"source": 3, "format": "f32"})
    assert response.headers["content-type"] == "application/octet-stream"
    assert np.frombuffer(response.content, "<f4") == pytest.approx(plain, rel=1e-6)


def test_the_path_alone_has_its_length(http, ring):
    query = {"source": 3, "target": 40, "distances": False}
    found = http.get(f"/v1/shapes/{ring['id']}/geodesics", params=query).json()
    assert found["distances"] is None
    path = np.array(found["path"])
    assert found["length"] == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def test_shapes_are_listed_by_name_and_the_newest_first(http):
    names = ["Alpha_1", "alpha 2", "50%", "beta"]
    for number, name in enumerate(names):
        stored(http, small_mesh(710 + number), name=name, label="listed", parameters=FEW)

    def listed(**query):
        return [item["name"] for item in http.get("/v1/shapes", params={"label": "listed", **query}).json()["items"]]

    assert listed(name="ALPHA") == ["Alpha_1", "alpha 2"]
    assert listed(name="%") == ["50%"]
    assert listed(name="_") == ["Alpha_1"]
    assert listed(order="newest") == names[::-1]
    page = http.get("/v1/shapes", params={"label": "listed", "order": "newest", "limit": 3}).json()
    assert listed(order="newest", cursor=page["next_cursor"]) == names[:1]
    assert http.get("/v1/shapes", params={"order": "size"}).status_code == 422


def test_one_stream_follows_all_jobs(http, server):
    seen, ready = [], threading.Event()

    def follow():
        with httpx.stream("GET", f"{server.url}/v1/jobs/events", timeout=60) as response:
            for line in response.iter_lines():
                ready.set()
                if line.startswith("data: "):
                    seen.append(json.loads(line[6:]))
                    if len({job["id"] for job in seen if job["state"] == "succeeded"}) == 2:
                        return

    thread = threading.Thread(target=follow)
    thread.start()
    assert ready.wait(60)
    sent = [post_mesh(http, small_mesh(number), parameters=FEW).json()["id"] for number in (720, 721)]
    thread.join(60)
    assert not thread.is_alive()
    ended = {job["id"] for job in seen if job["state"] == "succeeded"}
    assert ended == set(sent)
    assert all("result" not in job for job in seen)


def test_the_demo_is_sent_once(tmp_path):
    with Server(tmp_path, ready=False) as server, server.http() as http:
        sent = http.post("/v1/demo")
        assert sent.status_code == 202
        assert sent.json()["jobs"] > 50
        queued = http.get("/v1/jobs", params={"limit": 500}).json()["items"]
        assert len(queued) == sent.json()["jobs"]


def test_the_page_is_served_with_a_strict_policy(http):
    response = http.get("/")
    if not (FOLDER / "index.html").is_file():
        assert (response.status_code, response.headers["location"]) == (307, "/docs")
        pytest.skip("the package was installed without the page")
    policy = response.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; script-src 'self';")
    assert "unsafe" not in policy
    assert "://" not in response.text  # nothing from another host
    assert http.get("/", headers={"If-None-Match": response.headers["etag"]}).status_code == 304
    for name in (FOLDER / "assets").iterdir():
        asset = http.get(f"/assets/{name.name}")
        assert asset.content == name.read_bytes()
        assert "immutable" in asset.headers["cache-control"]
    assert http.get("/assets/none.js").status_code == 404
    assert http.get("/assets/..%2findex.html").status_code == 404
