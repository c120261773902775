"""Limits on the size of meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from unbend.errors import MeshTooLargeError


@dataclass(frozen=True)
class MeshLimits:
    """Limits on the vertices and triangles of a file before repair and simplification; None for no limit."""

    vertices: int | None = None
    faces: int | None = None

    def check(self, vertices: int, faces: int) -> None:
        """Raise MeshTooLargeError if `vertices` or `faces` exceed the limits."""
        for most, count, name in ((self.vertices, vertices, "vertices"), (self.faces, faces, "triangles")):
            if most is not None and count > most:
                raise MeshTooLargeError(f"the file has or announces more than {most:,} {name}")


UNLIMITED: Final = MeshLimits()
