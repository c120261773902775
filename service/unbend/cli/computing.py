"""Signatures of one file, or of many files on all cores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from unbend.cli.folder import LabelledFile
from unbend.cli.options import Values
from unbend.cli.terminal import announce_compilation, print_error, progress, stages, warn, warn_of
from unbend.errors import UnbendError
from unbend.mesh.policy import MeshPolicy

if TYPE_CHECKING:
    from unbend.arrays import Floats
    from unbend.embedding.embed import Method
    from unbend.mesh.surface import Surface
    from unbend.render.request import PictureRequest
    from unbend.signature.signature import Signature


@dataclass(frozen=True)
class Computed:
    """A file, its class, and its signature or its error; also its picture, if one was asked for."""

    file: LabelledFile
    signature: Signature | None
    error: str = ""
    picture: bytes | None = None


def read_file(mesh: Path, policy: Values) -> Surface:
    """Return the surface of a mesh file; print notes and warnings on standard error."""
    from unbend.mesh.read import read_mesh  # noqa: PLC0415

    announce_compilation()
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

    announce_compilation()
    chosen, read = Parameters.from_dict(parameters), MeshPolicy.from_dict(policy)
    with stages(mesh.name) as report:
        found = signature_of_file(mesh, chosen, read, local=local, progress=report)
    for note in found.surface.report.notes:
        warn(f"{mesh.name}: {note}")
    warn_of(mesh.name, found.signature.warnings)
    return found.signature


def compute_files(
    files: Sequence[LabelledFile], parameters: Values, policy: Values, picture: PictureRequest | None = None
) -> list[Computed]:
    """Return the signatures and the requested pictures of `files` in their order.

    Errors are printed, and other files are still computed.
    """
    announce_compilation(in_processes=True)
    with progress(_computed(files, parameters, policy, picture), "computing signatures", len(files)) as bar:
        results = list(bar)
    for result in results:
        if result.signature is None:
            print_error(f"{result.file.path}: {result.error}")
        else:
            warn_of(result.file.path, result.signature.warnings)
    return results


def _computed(
    files: Sequence[LabelledFile], parameters: Values, policy: Values, picture: PictureRequest | None
) -> Iterator[Computed]:
    from unbend.jobs.batch import compute_paths  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    paths = [file.path for file in files]
    outcomes = compute_paths(paths, Parameters.from_dict(parameters), MeshPolicy.from_dict(policy), picture=picture)
    for file, outcome in zip(files, outcomes, strict=True):
        if isinstance(outcome, UnbendError):
            yield Computed(file, None, str(outcome))
        else:
            yield Computed(file, outcome.signature, picture=outcome.picture)


def dimensions_of(
    files: Sequence[LabelledFile], parameters: Values, policy: Values
) -> dict[Path, dict[Method, Floats]]:
    """Return the moments in 1 to 6 dimensions by path, without files that have errors."""
    from unbend.jobs.batch import compute_each, dimensions_of_path  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415

    paths = [file.path for file in files]
    outcomes = compute_each(dimensions_of_path, paths, Parameters.from_dict(parameters), MeshPolicy.from_dict(policy))
    with progress(zip(paths, outcomes, strict=True), "embedding in 1 to 6 dimensions", len(paths)) as bar:
        return {path: outcome for path, outcome in bar if not isinstance(outcome, UnbendError)}
