"""The surface and the signature of one mesh file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from unbend.cli.options import Values
from unbend.cli.terminal import prepare_kernels, stages, warn, warn_of
from unbend.mesh.policy import MeshPolicy

if TYPE_CHECKING:
    from unbend.mesh.surface import Surface
    from unbend.signature.signature import Signature


def read_file(mesh: Path, policy: Values) -> Surface:
    """Return the surface of a mesh file; print notes and warnings on standard error."""
    from unbend.mesh.read import read_mesh  # noqa: PLC0415

    prepare_kernels()
    with stages(mesh.name) as report:
        surface = read_mesh(mesh, policy=MeshPolicy.from_dict(policy), progress=report)
    for note in surface.report.notes:
        warn(f"{mesh.name}: {note}")
    warn_of(mesh.name, surface.report.warnings)
    return surface


def compute_file(mesh: Path, parameters: Values, policy: Values, *, local: bool = False) -> Signature:
    """Return the signature of a mesh file; print notes and warnings on standard error."""
    from unbend.signature.from_file import signature_of_file  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    prepare_kernels()
    chosen, read = Parameters.from_dict(parameters), MeshPolicy.from_dict(policy)
    with stages(mesh.name) as report:
        found = signature_of_file(mesh, chosen, read, local=local, progress=report)
    for note in found.surface.report.notes:
        warn(f"{mesh.name}: {note}")
    warn_of(mesh.name, found.signature.warnings)
    return found.signature
