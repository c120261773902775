"""Evaluation of the labelled meshes of a folder, and its report, for `unbend evaluate DIR`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from unbend import __version__
from unbend.brief import counted
from unbend.cli.folders.computing import Computed, Machine, compute_files, dimensions_of
from unbend.cli.folders.files import LabelledFile, MeshFolder, read_labels, relative_name
from unbend.cli.options import Values
from unbend.cli.terminal import warn
from unbend.errors import ParameterError
from unbend.matching.class_map import class_map
from unbend.matching.evaluate import Clusters, Evaluation, Separation, clusters, evaluate, separation
from unbend.matching.evaluate.report import Report, ShapePicture, render
from unbend.matching.measures import VectorMeasure, get_vector_measure
from unbend.mesh.policy import MeshPolicy
from unbend.render.request import PictureRequest
from unbend.signature.dimensions import METHODS
from unbend.signature.parameters import Parameters
from unbend.signature.signature import ALGORITHM_VERSION

if TYPE_CHECKING:
    from unbend.arrays import Floats


@dataclass(frozen=True)
class Folder:
    """A folder of meshes and where their classes are."""

    path: Path
    labels: Path | None
    """A table; None if the name of a file's folder is its class."""
    gallery: Path | None
    """The table of the shapes that the others are compared with; None if they are compared with each other."""


@dataclass(frozen=True)
class FolderEvaluation:
    """The results for a folder: evaluations by measure, and the separation of classes if it was asked for."""

    evaluations: Mapping[str, Evaluation]
    separations: tuple[dict[str, Clusters], Separation] | None


def evaluate_folder(
    folder: Folder,
    measures: Sequence[str],
    machine: Machine,
    parameters: Values,
    policy: Values,
    *,
    separated: bool,
    html: Path | None,
) -> FolderEvaluation:
    """Evaluate retrieval on the labelled shapes of a folder, and write the report to `html`."""
    chosen = [get_vector_measure(name) for name in measures]
    if html and not html.parent.is_dir():
        raise ParameterError(f"{html}: there is no folder {html.parent}")
    queries = _table(folder.labels, folder) if folder.labels else _meshes(folder.path)
    others = _table(folder.gallery, folder) if folder.gallery else []
    computed = compute_files(queries + others, parameters, policy, machine, _picture() if html else None)
    found = computed[: len(queries)]
    compared = computed[len(queries) :] if folder.gallery else None
    evaluations = {measure.name: _evaluation(measure, found, compared) for measure in chosen}
    separations = _separations(chosen, found, parameters, policy, machine) if separated else None
    if html:
        given = {"folder": folder.path, "labels": folder.labels or "names of folders", "gallery": folder.gallery}
        maps = {measure.name: _map(measure, found) for measure in chosen}
        page = _page(
            evaluations, maps, separations, (found, compared), folder.path, given | _settings(parameters, policy)
        )
        html.write_text(page, encoding="utf-8", errors="backslashreplace")  # file names may not be UTF-8
    return FolderEvaluation(evaluations, separations)


def _meshes(folder: Path) -> list[LabelledFile]:
    source = MeshFolder(folder, None, True, [])
    found = [item for item in source if isinstance(item, LabelledFile)]
    if not found:
        raise ParameterError(source.emptiness)
    return found


def _table(labels: Path, folder: Folder) -> list[LabelledFile]:
    files = read_labels(labels, folder.path)
    found = [file for file in files if file.label is not None]
    if not found:
        raise ParameterError(f"{labels}: no row has a class")
    if len(found) < len(files):
        without = len(files) - len(found)
        verbs = "has no class and is" if without == 1 else "have no class and are"
        warn(f"{labels}: {without} of {counted(len(files), 'file')} {verbs} left out")
    return found


def _evaluation(measure: VectorMeasure, queries: Sequence[Computed], gallery: Sequence[Computed] | None) -> Evaluation:
    vectors, labels = _vectors(measure, queries)
    if gallery is None:
        if not vectors:
            raise ParameterError("none of the files can be used")
        return evaluate(measure.matrix(np.stack(vectors)), labels, labels, own=np.arange(len(vectors)))
    others, other_labels = _vectors(measure, gallery)
    if not others:
        raise ParameterError("none of the gallery's files can be used")
    stacked = np.stack(others)
    distances = measure.between(np.array(vectors, stacked.dtype).reshape(-1, stacked.shape[1]), stacked)
    failed = [str(item.file.label) for item in queries if not item.signature]
    return evaluate(distances, labels, other_labels, unanswered=failed)


def _vectors(measure: VectorMeasure, computed: Sequence[Computed]) -> tuple[list[Any], list[str]]:
    """Return the vectors and classes of the usable files."""
    usable = [(measure.vector(item.signature.descriptors), str(item.file.label)) for item in computed if item.signature]
    return [vector for vector, _ in usable], [label for _, label in usable]


def _map(measure: VectorMeasure, computed: Sequence[Computed]) -> Floats:
    """Return a point in the plane for each usable file."""
    return class_map(np.stack(_vectors(measure, computed)[0]), measure).points


def _separations(
    measures: Sequence[VectorMeasure],
    computed: Sequence[Computed],
    parameters: Values,
    policy: Values,
    machine: Machine,
) -> tuple[dict[str, Clusters], Separation]:
    """Return the separation of classes under each measure, and by the number of dimensions."""
    by_measure = {}
    for measure in measures:
        vectors, labels = _vectors(measure, computed)
        by_measure[measure.name] = clusters(measure.matrix(np.stack(vectors)), labels)
    usable = [item.file for item in computed if item.signature]
    found = dimensions_of(usable, parameters, policy, machine)
    labels = [str(file.label) for file in usable if file.path in found]
    stacked = {str(method): np.stack([of[method] for of in found.values()]) for method in METHODS} if found else {}
    return by_measure, separation(stacked, labels)


def _page(
    evaluations: Mapping[str, Evaluation],
    maps: Mapping[str, Floats],
    separations: tuple[dict[str, Clusters], Separation] | None,
    computed: tuple[Sequence[Computed], Sequence[Computed] | None],
    folder: Path,
    settings: Values,
) -> str:
    def names(some: Sequence[Computed]) -> list[str]:
        return [relative_name(item.file.path, folder) for item in some if item.signature]

    queries, gallery = computed
    shapes = [*queries, *(gallery or ())]
    report = Report(
        title=f"Evaluation of {folder.resolve().name}",
        evaluations=evaluations,
        queries=names(queries),
        gallery=names(queries if gallery is None else gallery),
        left_out=gallery is None,
        failures=[(relative_name(item.file.path, folder), item.error) for item in shapes if item.error],
        settings=settings,
        version=__version__,
        date=datetime.now(UTC).date(),
        maps=maps,
        clusters=separations[0] if separations else {},
        separation=separations[1] if separations else None,
        pictures=[
            ShapePicture(relative_name(item.file.path, folder), str(item.file.label), item.picture)
            for item in shapes
            if item.picture
        ],
    )
    return render(report)


def _picture() -> PictureRequest:
    """Return the request for the pictures of a report."""
    return PictureRequest(width=128, height=128, format="webp", theme="transparent")


def _settings(parameters: Values, policy: Values) -> Values:
    """Return every parameter, including defaults."""
    chosen = Parameters.from_dict(parameters).as_dict() | MeshPolicy.from_dict(policy).as_dict()
    return chosen | {"algorithm version": ALGORITHM_VERSION}
