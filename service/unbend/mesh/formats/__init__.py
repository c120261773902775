"""File formats, one module for each: it recognises, announces the size of, reads and writes its files."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Literal, get_args

FORMATS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "off": "model/vnd.off",
        "obj": "model/obj",
        "ply": "application/vnd.ply",
        "stl": "model/stl",
        "glb": "model/gltf-binary",
    }
)
"""Formats that are read, with their media types: single files, no archives, no references to other files."""

WrittenFormat = Literal["ply", "obj", "off", "glb"]

WRITTEN: Final = get_args(WrittenFormat)
"""Formats that are written."""
