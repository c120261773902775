"""File formats: each has a module that recognises its files, finds their announced size, reads and writes them."""

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
"""Formats that can be read, with their media types. All are single files without references to other files."""

WrittenFormat = Literal["ply", "obj", "off", "glb"]

WRITTEN: Final = get_args(WrittenFormat)
"""Formats that can be written."""
