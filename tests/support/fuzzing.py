"""Damaged mesh files (mutants), made from small valid files of every format, and identified by format and number."""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Callable
from functools import cache

import numpy as np

from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

FORMATS = ("off", "obj", "ply", "stl", "glb")

Rng = np.random.Generator
Mutation = Callable[[bytes, Rng], bytes]

NUMBERS = (
    b"0", b"-1", b"1", b"2147483647", b"2147483648", b"-2147483649", b"4294967295", b"99999999999", b"1000000000",
    b"9223372036854775808", b"-1000000000", b"1e308", b"-1e308", b"1e309", b"1e-320", b"1e999999", b"nan", b"-nan",
    b"inf", b"-inf", b"0x10", b"0x", b"1_0", b"1,5", b"1.5", b".5", b"5.", b"+7", b"--7", b"", b"1e", b"\xd9\xa3",
    b"\xef\xbc\x93", b"9" * 400, b"9" * 5000, b"true", b"null",
)  # fmt: skip
"""Numbers, and texts that look like numbers."""

INTEGERS = (0, 1, 2, 3, 255, 2**15, 2**16 - 1, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 10**9)
NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def mutant(file_type: str, number: int, seed: int = 0) -> bytes:
    """Return the damaged file of a format with this number; the same arguments always give the same file."""
    rng = np.random.default_rng([seed, FORMATS.index(file_type), number])
    files = seeds(file_type)
    data = files[int(rng.integers(len(files)))]
    for _ in range(int(rng.geometric(0.6))):
        data = MUTATIONS[int(rng.integers(len(MUTATIONS)))](data, rng)
    return data


def file_name(file_type: str, number: int) -> str:
    """Return the file name of a mutant: one in ten has the extension of another format, one in ten has none."""
    if number % 10 == 3:
        return "mesh"
    return f"mesh.{FORMATS[number // 10 % 5] if number % 10 == 7 else file_type}"


@cache
def seeds(file_type: str) -> tuple[bytes, ...]:
    return tuple(_SEEDS[file_type]())


def glb(layout: dict, binary: bytes = b"") -> bytes:
    """Return a glb file with a layout (JSON) and a binary chunk."""
    text = json.dumps(layout).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def triangle_layout(**changes: object) -> tuple[dict, bytes]:
    """Return the layout and the data of a glb with two triangles; `changes` replace members of the layout."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], "<f4").tobytes()
    corners = np.array([0, 1, 2, 1, 3, 2], "<u2").tobytes()
    layout = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(corners)},
        ],
        "buffers": [{"byteLength": len(points) + len(corners)}],
    }
    return layout | changes, points + corners


# The seeds


def _torus() -> tuple[np.ndarray, np.ndarray]:
    surface = torus(columns=7, rows=4)
    return surface.vertices, surface.faces


def _off() -> list[bytes]:
    vertices, faces = _torus()
    rows = b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1.5\n"
    quad, rest = b"4 0 1 2 3\n", b"3 0 1 4 255 0 0\n"
    colours = b"".join(line + b" 255 0 10 255\n" for line in rows.splitlines())
    normals = b"".join(line + b" 0 0 1\n" for line in rows.splitlines())
    texture = b"".join(line + b" 0.5 0.5\n" for line in rows.splitlines())
    return [
        write_mesh(vertices, faces, "off"),
        write_mesh(vertices, faces, "off", colours=np.full((len(vertices), 3), 0.5)),
        b"OFF\n# a comment\n5 2 0\n" + rows + quad + rest,
        b"OFF 5 2 6\n" + rows.replace(b"\n", b" # here\n") + quad + b"\n" + rest,
        b"COFF\n5 2 0\n" + colours + quad + rest,
        b"NOFF\r\n5 2 0\r\n" + normals + quad + rest,
        b"STOFF\n5 2 0\n" + texture + quad + rest,
        b"OFF\n6 1 0\n" + rows + b"2 2 2\n5 0 1 2 5 3\n",
        b"OFF6 1 0\n" + rows + b"0.5 0.2 0\n5 0 1 2 3 5\n",
        b"off\n5\n2\n0\n" + (rows + quad + rest).replace(b" ", b"\n"),
        b"4OFF\n5 2 0\n" + rows.replace(b"\n", b" 2\n") + quad + rest,
        b"COFF BINARY\n"
        + struct.pack(">3i", 5, 2, 0)
        + np.ones((5, 7), ">f4").tobytes()
        + struct.pack(">5ii4ii", 4, 0, 1, 2, 3, 0, 3, 0, 1, 4, 0),
    ]


def _obj() -> list[bytes]:
    vertices, faces = _torus()
    rows = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1.5\n"
    return [
        write_mesh(vertices, faces, "obj"),
        write_mesh(vertices, faces, "obj", uv=vertices[:, :2]),
        rows + b"f 1 2 3 4\nf 1 2 5\n",
        rows + b"vt 0 0\nvt 1 1\nvn 0 0 1\no first\nusemtl red\nf 1/1/1 2/2/1 3/1/1\ng second\nf -5/2 -3/1 -1/2\n",
        b"mtllib x.mtl\n" + rows.replace(b"\n", b" 1.0 0.5 0.2\n") + b"s off\nf 1//1 2//1 3//1 4//1 5//1\n",
        rows.replace(b" 0\n", b" \\\n0\n") + b"# end\nf 1 2 \\\n 3\nl 1 2\nf 1 3 4\n",
        rows.replace(b"\n", b"\r\n") + b"\t f 1 2 5\r\n",
        b"\xef\xbb\xbf" + rows.replace(b"\n", b"\r") + b"v 0.5 0.2 0\rF 1 2 3 4 6\rf 1 2\rodd\r",
    ]


_PLY_HEAD = "ply\nformat {} 1.0\ncomment made for tests\n"
_PLY_VERTEX = "element vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
_PLY_FACE = "element face 2\nproperty list uchar int vertex_indices\n"
_POINTS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1.5))


def _ply() -> list[bytes]:
    vertices, faces = _torus()
    text = "".join(f"{x} {y} {z}\n" for x, y, z in _POINTS) + "3 0 1 2\n3 0 1 4\n"
    mixed = text.replace("3 0 1 2\n", "4 0 1 2 3\n")
    colours = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    coloured = "".join(f"{x} {y} {z} 255 0 7\n" for x, y, z in _POINTS) + "3 0 1 2\n3 0 1 4\n"
    edges = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
    head = _PLY_HEAD.format("ascii")
    return [
        write_mesh(vertices, faces, "ply"),
        write_mesh(vertices, faces, "ply", colours=np.full((len(vertices), 3), 0.5)),
        f"{head}{_PLY_VERTEX}{_PLY_FACE}end_header\n{text}".encode(),
        f"{head}{_PLY_VERTEX}{_PLY_FACE}end_header\n{mixed}".encode(),
        f"{head}{_PLY_VERTEX}{colours}{_PLY_FACE}end_header\n{coloured}".encode(),
        f"{head}{_PLY_VERTEX}{_PLY_FACE}{edges}end_header\n{text}0 1\n".encode(),
        f"{head}comment TextureFile x.png\n{_PLY_VERTEX}{_PLY_FACE}end_header\r\n{text}".encode(),
        *(_binary_ply(order, extra) for order in "<>" for extra in (False, True)),
        _binary_ply("<", extra=False, corners=((0, 1, 2, 3), (0, 1, 4))),
        _binary_ply(">", extra=True, corners=((0, 1), (0, 1, 2, 3, 4))) + b"more",
        (
            _PLY_HEAD.format("binary_little_endian") + _PLY_VERTEX + "element tristrips 1\n"
            "property list int int vertex_indices\nend_header\n"
        )
        .replace("\n", "\r")
        .encode()
        + np.array(_POINTS, "<f4").tobytes()
        + struct.pack("<9i", 8, 0, 1, 3, 2, -1, 0, 1, 4),
    ]


def _binary_ply(order: str, extra: bool, corners: tuple[tuple[int, ...], ...] = ((0, 1, 2), (0, 1, 4))) -> bytes:
    head = _PLY_HEAD.format({"<": "binary_little_endian", ">": "binary_big_endian"}[order]) + _PLY_VERTEX
    head += "property double quality\n" * extra + _PLY_FACE
    head += "property list uchar float texcoord\nproperty short group\n" * extra
    body = b"".join(struct.pack(f"{order}3f", *point) + struct.pack(f"{order}d", 0.5) * extra for point in _POINTS)
    for face in corners:
        body += struct.pack(f"{order}B{len(face)}i", len(face), *face)
        body += struct.pack(f"{order}B6fh", 6, *(0.5,) * 6, 7) * extra
    return head.encode() + b"end_header\n" + body


def _stl() -> list[bytes]:
    import trimesh

    mesh = trimesh.Trimesh(*_torus(), process=False)
    text = (
        b"solid first\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
        b"facet normal 0 0 0\n outer loop\n  vertex 1 0 0\n  vertex 1e0 1.0 0\n  vertex 0 1 0\n endloop\nendfacet\n"
        b"endsolid first\n"
    )
    return [
        mesh.export(file_type="stl"),
        b"solid " + mesh.export(file_type="stl")[6:],
        mesh.export(file_type="stl_ascii").encode(),
        text,
        text + text.replace(b"first", b"second").replace(b"\n", b"\r\n"),
        text.upper(),
        b"\xef\xbb\xbf" + text.replace(b"endsolid first\n", b"").replace(b"\n", b"\r"),
        text.replace(b"\n", b" ").replace(b"vertex 0 1 0 endloop", b"vertex 0.2 0.2 0 vertex 0 1 0 endloop"),
        mesh.export(file_type="stl") + bytes(92),
    ]


def _glb() -> list[bytes]:
    vertices, faces = _torus()
    layout, data = triangle_layout()
    plain = layout["meshes"][0]["primitives"][0]
    nodes = [{"children": [1, 2], "scale": [2, 1, -1]}, {"mesh": 0}, {"mesh": 0, "translation": [0, 0, 1]}]
    turned = [{"mesh": 0, "rotation": [0, 0, 0.7, 0.7]}, {"mesh": 0, "matrix": np.eye(4).ravel().tolist()}]
    accessors = layout["accessors"]
    sparse = [
        accessors[0] | {"sparse": {
            "count": 1, "indices": {"bufferView": 1, "componentType": 5123, "byteOffset": 2},
            "values": {"bufferView": 0, "byteOffset": 12},
        }},
        accessors[1],
    ]  # fmt: skip
    skinned = [{"mesh": 0, "skin": 0, "scale": [3, 3, 3]}, {}]
    only = [{key: value for key, value in sparse[0].items() if key != "bufferView"}, accessors[1]]
    stride = [layout["bufferViews"][0] | {"byteStride": 12, "target": 34962}, layout["bufferViews"][1]]
    empty = [{key: value for key, value in accessor.items() if key != "bufferView"} for accessor in accessors]
    draco = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    embedded = [{"uri": "data:;base64," + base64.b64encode(data).decode(), "byteLength": len(data)}]
    return [
        write_mesh(vertices, faces, "glb"),
        write_mesh(vertices, faces, "glb", colours=np.full((len(vertices), 3), 0.5)),
        write_mesh(vertices, faces, "glb", uv=vertices[:, :2]),
        glb(layout, data),
        glb(layout | {"scenes": [{"nodes": [0]}], "nodes": nodes}, data),
        glb(layout | {"scenes": [{"nodes": [0, 1]}], "nodes": turned}, data),
        glb(layout | {"accessors": sparse}, data),
        glb(layout | {"accessors": only}, data),
        glb(layout | {"nodes": skinned, "skins": [{"joints": [1]}], "animations": [{}]}, data + bytes(4)),
        glb({key: value for key, value in layout.items() if "scene" not in key and key != "nodes"}, data),
        glb(layout | {"bufferViews": stride}, data),
        glb(layout | {"meshes": [{"primitives": [plain, plain | {"mode": 5}, plain | {"mode": 6}]}]}, data),
        glb(layout | {"buffers": embedded}),
        glb(layout | {"buffers": [{"uri": "other.bin", "byteLength": 60}]}),
        glb(layout | {"images": [{"uri": "http://127.0.0.1:9/x.png"}], "textures": [{"source": 0}]}, data),
        glb(layout | {"accessors": empty, "extensionsUsed": list(draco),
                      "meshes": [{"primitives": [plain | {"extensions": draco}]}]}, data),
    ]  # fmt: skip


_SEEDS: dict[str, Callable[[], list[bytes]]] = {"off": _off, "obj": _obj, "ply": _ply, "stl": _stl, "glb": _glb}


# The mutations


def _place(data: bytes, rng: Rng) -> int:
    return int(rng.integers(len(data) + 1))


def _one(choices: tuple, rng: Rng) -> object:
    return choices[int(rng.integers(len(choices)))]


def _flip_bits(data: bytes, rng: Rng) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9)) if data else 0):
        changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _change_bytes(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    fresh = rng.bytes(int(rng.integers(1, 9)))
    return data[:at] + fresh + data[at + len(fresh) :]


def _cut_end(data: bytes, rng: Rng) -> bytes:
    return data[: _place(data, rng)]


def _cut_out(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 60)) :]


def _insert(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    return data[:at] + rng.bytes(int(rng.integers(1, 20))) + data[at:]


def _repeat(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at : at + int(rng.integers(1, 200))] * int(rng.integers(1, 20)) + data[at:]


def _splice(data: bytes, rng: Rng) -> bytes:
    others = seeds(FORMATS[int(rng.integers(len(FORMATS)))])
    other = others[int(rng.integers(len(others)))]
    return data[: _place(data, rng)] + other[_place(other, rng) :]


def _append_another(data: bytes, rng: Rng) -> bytes:
    others = seeds(FORMATS[int(rng.integers(len(FORMATS)))])
    return data + others[int(rng.integers(len(others)))]


def _replace_number(data: bytes, rng: Rng) -> bytes:
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    number = found[int(rng.integers(len(found)))]
    return data[: number.start()] + _one(NUMBERS, rng) + data[number.end() :]


def _lie_in_header(data: bytes, rng: Rng) -> bytes:
    """Change one of the first numbers of the file, as text or as a binary integer at a typical place."""
    found = list(NUMBER.finditer(data[:400]))[:6]
    if found and rng.random() < 0.6:
        number = found[int(rng.integers(len(found)))]
        return data[: number.start()] + _one(NUMBERS, rng) + data[number.end() :]
    at = int(_one((4, 8, 12, 16, 20, 80, 84), rng))
    return data[:at] + struct.pack("<I", int(_one(INTEGERS, rng))) + data[at + 4 :]


def _write_integer(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    return data[:at] + struct.pack(str(_one(("<I", ">I"), rng)), int(_one(INTEGERS, rng))) + data[at + 4 :]


def _write_float(data: bytes, rng: Rng) -> bytes:
    at = _place(data, rng) & ~3
    value = float(_one((np.nan, np.inf, -np.inf, 3e38, 1e-45, -0.0, 1e20), rng))
    return data[:at] + struct.pack("<f", value) + data[at + 4 :]


def _drop_lines(data: bytes, rng: Rng) -> bytes:
    lines = data.splitlines(keepends=True)
    at = int(rng.integers(len(lines) + 1))
    return b"".join(lines[:at] + lines[at + int(rng.integers(1, 4)) :])


def _swap_lines(data: bytes, rng: Rng) -> bytes:
    lines = data.splitlines(keepends=True)
    if len(lines) > 1:
        first, second = rng.integers(len(lines), size=2)
        lines[first], lines[second] = lines[second], lines[first]
    return b"".join(lines)


def _swap_words(data: bytes, rng: Rng) -> bytes:
    words = re.split(rb"(\s+)", data)
    first, second = rng.integers(len(words), size=2)
    words[first], words[second] = words[second], words[first]
    return b"".join(words)


def _change_layout(data: bytes, rng: Rng) -> bytes:
    """Change a value in the JSON of a glb, and correct its lengths; in other files, replace a number."""
    if not data.startswith(b"glTF") or len(data) < 20:
        return _replace_number(data, rng)
    size = struct.unpack_from("<I", data, 12)[0]
    try:
        layout = json.loads(data[20 : 20 + size])
    except (ValueError, RecursionError):
        return _replace_number(data, rng)
    _change_inside(layout, rng)
    binary = data[20 + size + 8 :]
    return glb(layout, binary)


def _change_inside(value: object, rng: Rng) -> None:
    strange = (
        None, True, -1, 0, 1, 2, 3, 4, 5, 6, 5121, 5123, 5125, 5126, 1.5, 10**9, 2**31, 2**63, 10**30, "x", "",
        "SCALAR", "VEC2", "VEC3", "MAT4", [], [0], [0, 0], {}, {"bufferView": 0}, [[[]]], 1e308, float("nan"),
        "../../etc/passwd", [0] * 16,
    )  # fmt: skip
    while isinstance(value, dict | list) and value:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = keys[int(rng.integers(len(keys)))]
        inner = value[key]
        if isinstance(inner, dict | list) and inner and rng.random() < 0.8:
            value = inner
            continue
        if rng.random() < 0.2:
            del value[key]
        else:
            value[key] = _one(strange, rng)
        return


MUTATIONS: tuple[Mutation, ...] = (
    _flip_bits, _change_bytes, _cut_end, _cut_out, _insert, _repeat, _splice, _append_another, _replace_number,
    _replace_number, _replace_number, _lie_in_header, _lie_in_header, _write_integer, _write_float, _drop_lines,
    _swap_lines, _swap_words, _change_layout, _change_layout,
)  # fmt: skip
