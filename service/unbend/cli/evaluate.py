"""`unbend evaluate`."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from unbend.cli.computing import Machine, compute_files, dimensions_of, machine_options
from unbend.cli.folder import read_labels, relative_name
from unbend.cli.options import Values, folder_argument, json_option, parameter_options, policy_options, warn

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from unbend.arrays import Floats
    from unbend.cli.computing import Computed
    from unbend.cli.folder import LabelledFile
    from unbend.matching.evaluate import Clusters, Evaluation, Separation
    from unbend.matching.measures import VectorMeasure
    from unbend.render.request import PictureRequest

_CSV = click.Path(exists=True, dir_okay=False, path_type=Path)
_PAGE = click.Path(dir_okay=False, writable=True, path_type=Path)


@click.command()
@folder_argument
@click.option("--labels", required=True, type=_CSV, help="CSV with the columns path (relative to DIR) and class.")
@click.option("--measure", "measures", multiple=True, help="A measure to evaluate; may be repeated. All by default.")
@click.option("--gallery", type=_CSV, help="A second CSV: compare the shapes of --labels with the shapes in it.")
@json_option
@click.option("--per-class", is_flag=True, help="Add metrics of each class; with --json also confusions and curves.")
@click.option(
    "--separation",
    "separated",
    is_flag=True,
    help="Add the separation of classes in each measure, and in 1 to 6 dimensions; computes each shape again.",
)
@click.option("--html", metavar="FILE", type=_PAGE, help="Write a report with plots and pictures, as one HTML file.")
@machine_options
@parameter_options
@policy_options
def evaluate(
    folder: Path,
    labels: Path,
    measures: tuple[str, ...],
    gallery: Path | None,
    as_json: bool,
    per_class: bool,
    separated: bool,
    html: Path | None,
    machine: Machine,
    parameters: Values,
    policy: Values,
) -> None:
    """Measure retrieval on the labelled shapes of DIR.

    By default every shape is a query against all others (leave-one-out). With --gallery, the result is the share of
    shapes whose nearest class in the gallery is right. Unusable files are printed on standard error. With
    --gallery, unusable queries count as wrong.
    """
    from unbend.errors import ParameterError  # noqa: PLC0415
    from unbend.matching.measures import VECTOR_MEASURES, get_vector_measure  # noqa: PLC0415

    chosen = [get_vector_measure(name) for name in measures or VECTOR_MEASURES]
    if html and not html.parent.is_dir():
        raise ParameterError(f"{html}: there is no folder {html.parent}")
    queries = _with_class(read_labels(labels, folder), labels)
    others = _with_class(read_labels(gallery, folder), gallery) if gallery else []
    computed = compute_files(queries + others, parameters, policy, machine, _picture() if html else None)
    found = computed[: len(queries)]
    compared = computed[len(queries) :] if gallery else None
    evaluations = {measure.name: _evaluation(measure, found, compared) for measure in chosen}
    separations = _separations(chosen, found, parameters, policy, machine) if separated else None
    if html:
        given = {"folder": folder, "labels": labels, "gallery": gallery}
        maps = {measure.name: _map(measure, found) for measure in chosen}
        page = _page(evaluations, maps, separations, (found, compared), folder, given | _settings(parameters, policy))
        html.write_text(page, encoding="utf-8", errors="backslashreplace")  # file names may not be UTF-8
    if as_json:
        output = {
            name: result.as_dict() if per_class else _figures(result, compared is None)
            for name, result in evaluations.items()
        }
        if separations:
            output["separation"] = {name: asdict(of) for name, of in separations[0].items()} | {
                "dimensions": separations[1].as_dict()
            }
        click.echo(json.dumps(output))
    else:
        click.echo(_tables(evaluations, compared is None, per_class))
        if separations:
            click.echo("\n" + _tables_of_separation(*separations))


def _with_class(files: Sequence[LabelledFile], labels: Path) -> list[LabelledFile]:
    from unbend.errors import ParameterError  # noqa: PLC0415

    found = [file for file in files if file.label is not None]
    if not found:
        raise ParameterError(f"{labels}: no row has a class")
    if len(found) < len(files):
        warn(f"{labels}: {len(files) - len(found)} of {len(files)} files have no class and are left out")
    return found


def _evaluation(measure: VectorMeasure, queries: Sequence[Computed], gallery: Sequence[Computed] | None) -> Evaluation:
    import numpy as np  # noqa: PLC0415

    from unbend.errors import ParameterError  # noqa: PLC0415
    from unbend.matching.evaluate import evaluate as evaluated  # noqa: PLC0415

    vectors, labels = _vectors(measure, queries)
    if gallery is None:
        if not vectors:
            raise ParameterError("none of the files can be used")
        return evaluated(measure.matrix(np.stack(vectors)), labels, labels, own=np.arange(len(vectors)))
    others, other_labels = _vectors(measure, gallery)
    if not others:
        raise ParameterError("none of the gallery's files can be used")
    stacked = np.stack(others)
    distances = measure.between(np.array(vectors, stacked.dtype).reshape(-1, stacked.shape[1]), stacked)
    failed = [str(item.file.label) for item in queries if not item.signature]
    return evaluated(distances, labels, other_labels, unanswered=failed)


def _vectors(measure: VectorMeasure, computed: Sequence[Computed]) -> tuple[list[Any], list[str]]:
    """Return the vectors and classes of the usable files."""
    usable = [(measure.vector(item.signature.descriptors), str(item.file.label)) for item in computed if item.signature]
    return [vector for vector, _ in usable], [label for _, label in usable]


def _map(measure: VectorMeasure, computed: Sequence[Computed]) -> Floats:
    """Return a point in the plane for each usable file."""
    import numpy as np  # noqa: PLC0415

    from unbend.matching.class_map import class_map  # noqa: PLC0415

    return class_map(np.stack(_vectors(measure, computed)[0]), measure).points


def _separations(
    measures: Sequence[VectorMeasure],
    computed: Sequence[Computed],
    parameters: Values,
    policy: Values,
    machine: Machine,
) -> tuple[dict[str, Clusters], Separation]:
    """Return the separation of classes under each measure, and by the number of dimensions."""
    import numpy as np  # noqa: PLC0415

    from unbend.matching.evaluate import clusters, separation  # noqa: PLC0415
    from unbend.signature.dimensions import METHODS  # noqa: PLC0415

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
    from unbend import __version__  # noqa: PLC0415
    from unbend.matching.evaluate.report import Report, ShapePicture, render  # noqa: PLC0415

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
    from unbend.render.request import PictureRequest  # noqa: PLC0415

    return PictureRequest(width=128, height=128, format="webp", theme="transparent")


def _settings(parameters: Values, policy: Values) -> Values:
    """Return every parameter, including defaults."""
    from unbend.mesh.policy import MeshPolicy  # noqa: PLC0415
    from unbend.signature.parameters import Parameters  # noqa: PLC0415
    from unbend.signature.signature import ALGORITHM_VERSION  # noqa: PLC0415

    chosen = Parameters.from_dict(parameters).as_dict() | MeshPolicy.from_dict(policy).as_dict()
    return chosen | {"algorithm version": ALGORITHM_VERSION}


def _figures(evaluation: Evaluation, left_out: bool) -> dict[str, float]:
    if left_out and evaluation.metrics:
        return asdict(evaluation.metrics)
    return {"accuracy": evaluation.accuracy}


def _tables(evaluations: Mapping[str, Evaluation], left_out: bool, per_class: bool) -> str:
    from unbend.cli.tables import table  # noqa: PLC0415

    columns = [] if left_out else ["accuracy"]
    columns += ["nn", "ft", "st", "e", "dcg", "map"]
    figures = {name: result.as_dict() for name, result in evaluations.items()}
    overall = table("measure", columns, list(figures.items()))
    if not per_class:
        return overall
    classes = [
        table(name, ["queries", "members", *columns], [(row["label"], row) for row in result["classes"]])
        for name, result in figures.items()
    ]
    return "\n\n".join([overall, *classes])


def _tables_of_separation(by_measure: Mapping[str, Clusters], over: Separation) -> str:
    from unbend.cli.tables import table  # noqa: PLC0415

    first = table("measure", ["nearest", "ratio"], [(name, asdict(of)) for name, of in by_measure.items()])
    if not over.pairs:
        return f"{first}\n\nno two classes have two shapes each: there is no separation by dimensions"
    medians = over.medians
    columns = [f"m = {m}" for m in range(1, 1 + max(map(len, medians.values())))]
    rows = [(method, dict(zip(columns, of, strict=True))) for method, of in medians.items()]
    return f"{first}\n\n{table('log ratio', columns, rows)}"
