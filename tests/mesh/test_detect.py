"""Detection of the file format by the content, and never by the file name alone."""

from __future__ import annotations

import gzip
import io
import struct
import zipfile

import pytest

from tests.support.fuzzing import FORMATS, seeds
from unbend.errors import MeshFormatError
from unbend.mesh.formats import FORMATS as NAMES
from unbend.mesh.formats.detect import detect_format
from unbend.mesh.formats.registry import REGISTRY

OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def zipped(name: str) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, OBJ * 1000)
    return packed.getvalue()


def test_the_registry_has_all_named_formats():
    assert set(REGISTRY) == set(NAMES) == set(FORMATS)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("hint", [None, "", "txt", "obj", "stl"])
def test_the_format_is_detected_by_content_whatever_the_name(kind, hint):
    for data in seeds(kind):
        assert detect_format(data, hint) == kind


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (b"OFF6 8 0\n", "off"),
        (b"off\n", "off"),
        (b"OFF BINARY\n", "off"),
        (b"4OFF\n", "off"),
        (b"# x\n\nCOFF # y\n", "off"),
        (b"\xef\xbb\xbfOFF\r1 1 0\r", "off"),
        (b"PLY\r\n", "ply"),
        (b"\xef\xbb\xbfply\n", "ply"),
        (b"\xef\xbb\xbfv 1 2 3", "obj"),
        (b"# x\rV 1 2 3\r", "obj"),
        (OBJ + bytes(100), "obj"),
        (b"\xef\xbb\xbf\n SOLID x\nFACET", "stl"),
        (b"facet normal 0 0 1\n", "stl"),
    ],
)
def test_text_formats_are_detected_by_their_first_words(data, kind):
    assert detect_format(data) == kind


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (b"Kaydara FBX Binary  \0", "FBX"),
        (b"BLENDER-v300", "Blender"),
        (b"# vtk DataFile Version 3.0\n" + OBJ, "VTK"),
        (b'<?xml version="1.0"?>\n<VTKFile type="PolyData">', "VTK"),
        (b'<?xml version="1.0"?>\n<COLLADA xmlns="">', "COLLADA"),
        (b'<?xml version="1.0"?><X3D>', "X3D"),
        (b"#VRML V2.0 utf8\n", "VRML"),
        (b"ISO-10303-21;\n", "STEP"),
        (b"PXR-USDC\0", "USD"),
        (b"#usda 1.0\n", "USD"),
        (b"$MeshFormat\n4.1 0 8\n", "Gmsh"),
        (b"CQUAD\n0 0 0 1 0 0 1 1 0 0 1 0\n", "Geomview"),
        (b"<!DOCTYPE html><html>v 1 2 3", "web page"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
        (b'{"scene": 0, "asset": {"version": "2.0"}}', "glTF as text"),
        (OBJ.decode().encode("utf-16"), "UTF-16"),
        (OBJ.decode().encode("utf-16-be"), "UTF-16"),
        (OBJ.decode().encode("utf-32"), "UTF-16 or UTF-32"),
        (b" " * 72 + b"S      1\n", "IGES"),
        (gzip.compress(OBJ, mtime=0), "gzip"),
        (zipped("mesh.obj"), r"packed \(zip\)"),
        (zipped("3D/3dmodel.model"), "3MF"),
        (zipped("scene.usdc"), "USDZ"),
        (b"\x89PNG\r\n\x1a\n", "a picture"),
    ],
)
@pytest.mark.parametrize("hint", [None, "obj", "stl"])
def test_unsupported_formats_are_named_with_the_supported_ones(data, name, hint):
    with pytest.raises(MeshFormatError, match=name) as raised:
        detect_format(data, hint)
    assert "off, obj, ply, stl, glb" in str(raised.value)


@pytest.mark.parametrize(
    "data", [b"off the record\n", b"plywood\n", b"solid ground\n", b"offset 1 2\n", b"verse 1 2\n"]
)
def test_words_that_only_begin_like_a_keyword_are_not_detected(data):
    with pytest.raises(MeshFormatError, match="format of the file is unknown"):
        detect_format(data)


@pytest.mark.parametrize("hint", [None, "", "glb", "obj", "off", "ply", "stl", "txt"])
@pytest.mark.parametrize("data", [b"", b" \r\n\t\n"])
def test_an_empty_file_is_reported_as_empty_whatever_its_name(data, hint):
    with pytest.raises(MeshFormatError, match="the file is empty"):
        detect_format(data, hint)


@pytest.mark.parametrize("hint", ["glb", "ply"])
def test_a_file_name_does_not_replace_the_magic_bytes_of_a_format(hint):
    with pytest.raises(MeshFormatError, match=f"does not begin like a {hint} file"):
        detect_format(bytes(range(1, 256)), hint)


def test_extra_bytes_prevent_the_detection_of_binary_stl():
    noise = b"\xff" * 80 + struct.pack("<I", 1) + b"\xff" * 60
    with pytest.raises(MeshFormatError):
        detect_format(noise)
