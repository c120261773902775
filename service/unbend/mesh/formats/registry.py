"""The readers and writers of all formats, in the order in which their content tests run: the most certain first."""

from __future__ import annotations

from typing import Final

from unbend.mesh.formats.glb import GLB
from unbend.mesh.formats.obj import OBJ
from unbend.mesh.formats.off import OFF
from unbend.mesh.formats.parsed import MeshFormat
from unbend.mesh.formats.ply import PLY
from unbend.mesh.formats.stl import STL

REGISTRY: Final[dict[str, MeshFormat]] = {known.name: known for known in (STL, GLB, PLY, OFF, OBJ)}
