"""Formats that cannot be read. Error messages name them, so that the sender knows what to do."""

from __future__ import annotations

import re
from typing import Final

_HEAD: Final = 4096
_PACKED: Final = {
    b"PK\x03\x04": "zip", b"PK\x05\x06": "zip", b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ\0": "xz",
    b"7z\xbc\xaf\x27\x1c": "7z", b"Rar!": "rar", b"\x28\xb5\x2f\xfd": "zstd", b"DRACO": "Draco",
}  # fmt: skip
"""First bytes of archives and compressed files, none of which is unpacked."""

_INSIDE: Final = {b"3dmodel.model": "3MF", b".usdc": "USDZ", b".usda": "USDZ"}
"""Names of files in a zip archive that identify its format."""

_WIDE: Final = (b"\xff\xfe", b"\xfe\xff", b"\0\0\xfe\xff")
_KNOWN: Final = (
    (rb"Kaydara FBX Binary|; ?FBX \d", "an FBX file"),
    (rb"BLENDER", "a Blender file"),
    (rb"# vtk DataFile", "a VTK file"),
    (rb"(?s)\s*<.{0,500}VTKFile\b", "a VTK file"),
    (rb"(?s)\s*<.{0,2000}COLLADA\b", "a COLLADA file"),
    (rb"(?s)\s*<.{0,2000}X3D\b|#X3D\b", "an X3D file"),
    (rb"(?s)\s*<.{0,500}amf\b", "an AMF file"),
    (rb"(?s)\s*<.{0,500}html\b", "a web page, perhaps from a failed download"),
    (rb"#VRML\b", "a VRML file"),
    (rb"ISO-10303-21", "a STEP file"),
    (rb"[^\r\n]{72}S {0,6}0*1\b", "an IGES file"),
    (rb"(?s)FORM.{4}LWO[2B]", "a LightWave file"),
    (rb"OCTM", "an OpenCTM file"),
    (rb"PXR-USDC|#usda\b", "a USD file"),
    (rb"//Maya ASCII", "a Maya file"),
    (rb"\$MeshFormat", "a Gmsh file"),
    (rb"(?-i:[CNZ4U]{0,4}(?:QUAD|MESH|VECT|SKEL|LIST|INST))\s", "a Geomview file, but not off"),
    (rb"\s*MeshVersionFormatted", "a Medit file"),
    (rb"Ogawa", "an Alembic file"),
    (rb"\x89HDF", "an HDF5 file"),
    (rb"(?s)MM.{4}\x02\0", "a 3ds file"),
    (rb"# \.PCD\b|LASF", "a point cloud"),
    (rb"\s*0\s{1,9}SECTION\b", "a DXF file"),
    (rb"version https://git-lfs", "a Git LFS pointer instead of the file itself"),
    (rb"\x89PNG|\xff\xd8\xff|GIF8|%PDF", "a picture or a document"),
)  # fmt: skip
_PATTERNS: Final = tuple((re.compile(pattern, re.IGNORECASE), name) for pattern, name in _KNOWN)
_GLTF: Final = re.compile(rb'\s*\{.*"asset"\s*:', re.DOTALL)


def other_format(data: bytes) -> str | None:
    """Return a sentence that names the format of a file, if it is known but not read; otherwise None."""
    head = data[:_HEAD].removeprefix(b"\xef\xbb\xbf")
    if packing := _packing(data):
        return f"the file is packed ({packing}) and is not unpacked: send the mesh itself"
    if _is_wide(head):
        return "the file is text in UTF-16 or UTF-32: save it as UTF-8 or ASCII"
    if _GLTF.match(head):
        return "the file is glTF as text, which may refer to other files: export a single binary file, glb"
    name = next((name for pattern, name in _PATTERNS if pattern.match(head)), None)
    return f"the file is {name}" if name else None


def _packing(data: bytes) -> str | None:
    if data[257:262] == b"ustar":
        return "tar"
    found = next((name for beginning, name in _PACKED.items() if data[:16].startswith(beginning)), None)
    if found != "zip":
        return found
    names = data[:_HEAD] + data[-_HEAD:]  # a zip file lists its files at its end
    return next((f"zip, like all {name} files" for word, name in _INSIDE.items() if word in names), found)


def _is_wide(head: bytes) -> bool:
    """Return whether text has two or four bytes per character, judged by a byte order mark or by alternating zeros."""
    if head.startswith(_WIDE):
        return True
    start = head[:64]
    return len(start) >= 8 and any(
        not start[zeros::2].strip(b"\0") and re.fullmatch(rb"[\t\r\n -~]+", start[1 - zeros :: 2]) for zeros in (0, 1)
    )
