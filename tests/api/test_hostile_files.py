"""Malicious uploads: decompression bombs, files that refer to other files, and file names that are paths."""

from __future__ import annotations

import bz2
import gzip
import http.server
import io
import lzma
import struct
import tarfile
import threading
import zipfile
from collections.abc import Iterator
from email.message import Message

import httpx
import pytest

from tests.support.fuzzing import glb, triangle_layout
from tests.support.problem import check
from tests.support.server import ended, post_mesh, small_mesh, stored

FEW = '{"samples": 8}'
OFF = b"OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0.5\n3 0 1 2\n3 1 3 2\n"
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0.5\nf 1 2 3\nf 2 4 3\n"


@pytest.fixture(scope="module")
def client(server) -> Iterator[httpx.Client]:
    with server.http() as http:
        yield http
    assert "Traceback" not in server.log.read_text()


class Canary(http.server.BaseHTTPRequestHandler):
    """Answers with the data of `triangle_layout`, and records the requested paths."""

    asked: list[str]

    def do_GET(self) -> None:
        self.asked.append(self.path)
        self.send_response(200)
        self.end_headers()
        self.wfile.write(triangle_layout()[1])

    do_HEAD = do_GET  # noqa: N815

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def canary() -> Iterator[tuple[str, list[str]]]:
    """The address of a server that has a file's missing data, and the list of paths requested from it."""
    asked: list[str] = []
    handler = type("Asked", (Canary,), {"asked": asked})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as served:
        thread = threading.Thread(target=served.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{served.server_port}", asked
        served.shutdown()
        thread.join()


def failure(client: httpx.Client, data: bytes, file_name: str) -> dict:
    """Upload a file; return the error of its job."""
    job = ended(client, post_mesh(client, data, file_name=file_name, parameters=FEW))
    assert job["state"] == "failed", job
    assert job["attempts"] == 1
    assert job["error"]["message"]
    assert job["error"]["advice"]
    assert len(job["error"]["message"]) < 300
    return job["error"]


# Packed files


def zipped() -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mesh.off", OFF)
        archive.writestr("bomb.off", bytes(2**26))
    return packed.getvalue()


def tarred() -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        entry = tarfile.TarInfo("../../mesh.off")
        entry.size = len(OFF)
        archive.addfile(entry, io.BytesIO(OFF))
    return packed.getvalue()


PACKED = {
    "zip": zipped(),
    "gzip": gzip.compress(OFF + bytes(2**26)),
    "tar": tarred(),
    "bzip2": bz2.compress(OFF),
    "xz": lzma.compress(OFF),
    "Draco": b"DRACO\x02\x02\x01\x01\x00\x00\x00\xff\xff\xff\xff\x0f",
}


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
@pytest.mark.parametrize("file_name", ["mesh.zip", "mesh.off", "mesh"])
@pytest.mark.parametrize("packing", PACKED)
def test_compressed_files_are_refused_under_any_name(client, packing, file_name, path):
    response = client.post(path, files={"file": (file_name, PACKED[packing])})
    assert packing in check(response, 415, "mesh_format")["detail"]


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
def test_a_compressed_request_body_is_refused(client, path):
    request = client.build_request("POST", path, files={"file": ("mesh.off", OFF)})
    headers = {"Content-Type": request.headers["content-type"], "Content-Encoding": "gzip"}
    check(client.post(path, content=gzip.compress(request.read()), headers=headers), 400, "bad_request")


def test_gltf_as_json_is_refused(client):
    check(post_mesh(client, b'{"asset": {"version": "2.0"}}', file_name="mesh.gltf"), 415, "mesh_format")


# Small files that announce huge ones


def without_data(**more: object) -> list[dict]:
    return [
        {"componentType": 5126, "count": 10**6, "type": "VEC3"} | more,
        {"componentType": 5125, "count": 3 * 10**6, "type": "SCALAR"} | more,
    ]


def compressed(required: bool) -> bytes:
    extension = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    primitive = {"attributes": {"POSITION": 0}, "indices": 1, "extensions": extension}
    names = {"extensionsUsed": list(extension)} | ({"extensionsRequired": list(extension)} if required else {})
    layout, data = triangle_layout(accessors=without_data(), meshes=[{"primitives": [primitive]}], **names)
    return glb(layout, data)


def compressed_views() -> bytes:
    layout, data = triangle_layout(extensionsUsed=["EXT_meshopt_compression"])
    for view in layout["bufferViews"]:
        view["extensions"] = {
            "EXT_meshopt_compression": {"buffer": 0, "byteLength": 8, "count": 10**9, "byteStride": 12}
        }
    return glb(layout, data)


def many_instances() -> bytes:
    layout, data = triangle_layout(nodes=[{"mesh": 0} for _ in range(20_000)], scenes=[{"nodes": list(range(20_000))}])
    layout["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}] * 200}]
    return glb(layout, data)


def many_points(count: int) -> bytes:
    layout, data = triangle_layout()
    layout["accessors"][0]["count"] = count
    return glb(layout, data)


PLY = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n"
LIST = "property list {} int vertex_indices\nend_header\n"
TEXT = "0 0 0\n1 0 0\n0 1 0\n"

BOMBS = {
    "off announces": (b"OFF\n1000000000 1000000000 0\n0 0 0\n", "mesh_too_large"),
    "ply announces": (PLY.format("ascii", 10**9, 10**9).encode() + LIST.format("uchar").encode(), "mesh_too_large"),
    "ply lists": (
        PLY.format("binary_little_endian", 3, 1).encode() + LIST.format("uint").encode() + bytes(36) + b"\xff" * 16,
        "mesh_read",
    ),
    "ply text lists": (
        (PLY.format("ascii", 3, 1) + LIST.format("uint") + TEXT + "4000000000 0 1 2\n").encode(),
        "mesh_read",
    ),
    "stl announces": (bytes(80) + b"\xff\xff\xff\xff" + bytes(50), "mesh_too_large"),
    "glb draco": (compressed(required=True), "mesh_format"),
    "glb draco, not required": (compressed(required=False), "mesh_format"),
    "glb meshopt": (compressed_views(), "mesh_format"),
    "glb without data": (glb(triangle_layout(accessors=without_data())[0]), "mesh_format"),
    "glb points": (many_points(10**9), "mesh_too_large"),
    "glb points within the limits": (many_points(10**6), "mesh_read"),
    "glb instances": (many_instances(), "mesh_too_large"),
    "glb nesting": (struct.pack("<4sIII4s", b"glTF", 2, 20 + 10**5, 10**5, b"JSON") + b"[" * 10**5, "mesh_read"),
}  # fmt: skip


@pytest.mark.parametrize("bomb", BOMBS)
def test_small_files_that_announce_huge_meshes_are_refused(client, bomb):
    data, code = BOMBS[bomb]
    assert failure(client, data, f"mesh.{bomb.split()[0]}")["code"] == code


# Files that refer to other files


def test_a_glb_with_external_data_is_refused_and_the_data_is_not_opened(client, canary, tmp_path):
    address, asked = canary
    layout, data = triangle_layout()
    path = tmp_path / "data.bin"
    path.write_bytes(data)
    for uri in (str(path), path.as_uri(), f"{address}/data.bin", "data.bin", f"data:{path}", "x" * 10_000):
        elsewhere = layout | {"buffers": [{"uri": uri, "byteLength": len(data)}]}
        error = failure(client, glb(elsewhere), "mesh.glb")
        assert (error["code"], "another" in error["message"]) == ("mesh_format", True)
    assert asked == []


def test_external_textures_and_materials_are_not_opened(client, canary, tmp_path):
    address, asked = canary
    path = tmp_path / "more.obj"
    path.write_bytes(OBJ.replace(b"1", b"7") + OBJ)
    layout, data = triangle_layout()
    layout |= {"images": [{"uri": f"{address}/x.png"}], "textures": [{"source": 0}]}
    layout["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    layout["meshes"] = [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}]
    named = "".join(f"{word} {place}\n" for word in ("mtllib", "call", "maplib") for place in (path, address)).encode()
    text = PLY.format("ascii", 3, 1).replace("1.0\n", f"1.0\ncomment TextureFile {address}/x.png\n", 1)
    files = {
        "mesh.glb": (glb(layout, data), 4),
        "mesh.obj": (named + OBJ, 4),
        "mesh.ply": ((text + LIST.format("uchar") + TEXT + "3 0 1 2\n").encode(), 3),
    }
    for file_name, (file, vertices) in files.items():
        assert stored(client, file, file_name=file_name, parameters=FEW)["report"]["vertices"] == vertices
    assert asked == []


# Names

NAMES = {
    b"../../etc/passwd": "passwd",
    b"/etc/passwd.ply": "passwd",
    b"C:\\\\Windows\\\\mesh.ply": "mesh",
    b"..\\\\..\\\\mesh.ply": "mesh",
    b"a\0b.ply": "a\0b",
    b"a\tb.ply": "a\tb",
    b"a\xff\xfe.ply": "aÿþ",
    b"..": "..",
    b"": "unnamed",
    b"/": "unnamed",
    b"x" * 3000 + b".ply": "x" * 200,
    b"evil.exe%0d%0aSet-Cookie: a=b": "evil",
    "\u202eylp.exe".encode(): "\u202eylp",
    b'mesh.ply\\"; filename=\\"evil.exe': 'mesh.ply"; filename="evil',
}


@pytest.mark.parametrize("file_name", NAMES, ids=lambda name: repr(name[:20]))
def test_an_uploaded_file_name_is_never_used_as_a_path_or_header(client, server, file_name):
    before = {path.name for path in server.library.parent.iterdir()}
    data = small_mesh(300 + list(NAMES).index(file_name))
    response = post_named(client, file_name, data)
    job = ended(client, response)
    shape = client.get(f"/v1/shapes/{job['shape_id']}").json()
    assert shape["name"] == NAMES[file_name]
    check_download(client, shape["id"], data)
    assert {path.name for path in server.library.parent.iterdir()} == before


def test_an_overlong_file_name_is_refused_or_cut(client):
    response = post_named(client, b"x" * 10_000 + b".ply", small_mesh(330))
    if response.status_code == 400:
        check(response, 400, "bad_request")
    else:
        job = ended(client, response)
        assert client.get(f"/v1/shapes/{job['shape_id']}").json()["name"] == "x" * 200


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("via", ["field", "patch"])
def test_the_name_of_a_shape_is_never_used_as_a_header(client, number, via):
    name = ("a\r\nSet-Cookie: a=b", "a\0/../b\n\n<script>", '"; filename="evil.exe')[number]
    data = small_mesh(340 + number)
    if via == "field":
        shape = stored(client, data, name=name, parameters=FEW)
        shape_id = shape["id"]
    else:
        shape_id = stored(client, data, parameters=FEW)["id"]
        shape = client.patch(f"/v1/shapes/{shape_id}", json={"name": name}).json()
    assert shape["name"] == name
    check_download(client, shape_id, data)


def test_a_name_that_is_not_valid_unicode_is_refused(client):
    shape_id = stored(client, small_mesh(350), parameters=FEW)["id"]
    headers = {"Content-Type": "application/json"}
    response = client.patch(f"/v1/shapes/{shape_id}", content=b'{"name": "\\ud800"}', headers=headers)
    check(response, 422, "request_invalid")


@pytest.mark.parametrize("shape_id", ["..%2f..%2fetc%2fpasswd", "%2e%2e", "a%00b", "x" * 5000, "' OR 1=1 --"])
def test_a_path_in_place_of_an_id_is_not_found(client, shape_id):
    for kind in ("shapes", "jobs"):
        check(client.get(f"/v1/{kind}/{shape_id}"), 404, "not_found")


def post_named(client: httpx.Client, file_name: bytes, data: bytes) -> httpx.Response:
    """Upload with an unescaped file name, which HTTP clients would escape."""
    head = b'--b\r\nContent-Disposition: form-data; name="file"; filename="' + file_name + b'"\r\n\r\n'
    parameters = b'\r\n--b\r\nContent-Disposition: form-data; name="parameters"\r\n\r\n' + FEW.encode()
    body = head + data + parameters + b"\r\n--b--\r\n"
    return client.post("/v1/shapes", content=body, headers={"Content-Type": "multipart/form-data; boundary=b"})


_ALSO = {"etag", "accept-ranges", "content-encoding"}
"""Headers about the transfer, which contain no name."""


def check_download(client: httpx.Client, shape_id: str, data: bytes) -> None:
    """Check that a shape's downloads have one safe file name and no unexpected header."""
    plain = client.get("/v1/livez")
    for path, file_type in (("mesh", "ply"), ("signature", "json")):
        response = client.get(f"/v1/shapes/{shape_id}/{path}")
        assert response.status_code == 200
        assert set(response.headers) - set(plain.headers) - _ALSO == {"content-disposition", "vary"}
        reported = Message()
        reported["content-disposition"] = response.headers["content-disposition"].split("; filename*")[0]
        assert reported.get_content_disposition() == "attachment"
        file_name = reported.get_filename()
        assert file_name is not None
        assert file_name.endswith(f".{file_type}")
        assert file_name.isascii()
        assert not set(file_name) & set('/\\":;\r\n\0')
    assert client.get(f"/v1/shapes/{shape_id}/mesh").content == data
