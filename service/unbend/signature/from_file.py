"""The signature of a mesh file: read the surface, then compute its signature."""

from __future__ import annotations

from dataclasses import dataclass

from unbend.mesh.limits import MeshLimits
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.mesh.sources import MeshSource
from unbend.mesh.surface import Surface
from unbend.progress import ProgressCallback
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import Signature


@dataclass(frozen=True)
class FileSignature:
    """The surface that was read from a file, and its signature."""

    surface: Surface
    signature: Signature


def signature_of_file(
    source: MeshSource,
    parameters: Parameters | None = None,
    policy: MeshPolicy | None = None,
    *,
    file_type: str | None = None,
    limits: MeshLimits | None = None,
    progress: ProgressCallback | None = None,
    threads: int | None = None,
    local: bool = False,
) -> FileSignature:
    """Read a mesh and compute its signature. See `read_mesh` and `compute_signature` for arguments and errors."""
    surface = read_mesh(source, file_type=file_type, policy=policy, limits=limits, progress=progress)
    signature = compute_signature(surface, parameters, progress=progress, threads=threads, local=local)
    return FileSignature(surface, signature)
