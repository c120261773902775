"""`unbend evaluate`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from unbend.cli.options import Values, folder_argument, json_option, parameter_options, policy_options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from unbend.cli.computing import Computed
    from unbend.matching.measures import VectorMeasure

_CSV = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command()
@folder_argument
@click.option("--labels", required=True, type=_CSV, help="CSV with the columns path (relative to DIR) and class.")
@click.option("--measure", "measures", multiple=True, help="Only this measure; may be repeated. All by default.")
@click.option("--gallery", type=_CSV, help="A second CSV, of the shapes that --labels' are compared with.")
@json_option
@parameter_options
@policy_options
def evaluate(
    folder: Path,
    labels: Path,
    measures: tuple[str, ...],
    gallery: Path | None,
    as_json: bool,
    parameters: Values,
    policy: Values,
) -> None:
    """Measure retrieval on the labelled shapes of DIR.

    Leave-one-out by default: every shape is a query against all others. With --gallery: how often the nearest
    class among the gallery's shapes is the right one. Files that cannot be used are named on standard error;
    as queries against a gallery they count as wrong.
    """
    from unbend.cli.computing import compute_files  # noqa: PLC0415
    from unbend.cli.folder import read_labels  # noqa: PLC0415
    from unbend.matching.measures import VECTOR_MEASURES, get_vector_measure  # noqa: PLC0415

    chosen = [get_vector_measure(name) for name in measures or VECTOR_MEASURES]
    queries = read_labels(labels, folder)
    others = read_labels(gallery, folder) if gallery else []
    computed = compute_files(queries + others, parameters, policy)
    found, held = computed[: len(queries)], computed[len(queries) :]
    figures = {
        measure.name: _accuracy(measure, found, held) if gallery else _leave_one_out(measure, found)
        for measure in chosen
    }
    click.echo(json.dumps(figures) if as_json else _table(figures))


def _leave_one_out(measure: VectorMeasure, computed: Sequence[Computed]) -> dict[str, float]:
    import numpy as np  # noqa: PLC0415

    from unbend.errors import ParameterError  # noqa: PLC0415
    from unbend.matching.evaluate import leave_one_out  # noqa: PLC0415

    usable = [(item.signature, str(item.file.label)) for item in computed if item.signature]
    if not usable:
        raise ParameterError("none of the files can be used")
    vectors = np.stack([measure.vector(signature.descriptors) for signature, _ in usable])
    return asdict(leave_one_out(measure.matrix(vectors), [label for _, label in usable]))


def _accuracy(measure: VectorMeasure, queries: Sequence[Computed], gallery: Sequence[Computed]) -> dict[str, float]:
    import numpy as np  # noqa: PLC0415

    from unbend.errors import ParameterError  # noqa: PLC0415
    from unbend.matching.evaluate import nearest_class_accuracy  # noqa: PLC0415
    from unbend.matching.gallery import Gallery  # noqa: PLC0415
    from unbend.matching.ranking import rank_classes  # noqa: PLC0415

    held = [(item.signature, item.file.label) for item in gallery if item.signature]
    if not held:
        raise ParameterError("none of the gallery's files can be used")
    vectors = np.stack([measure.vector(signature.descriptors) for signature, _ in held])
    shapes = Gallery.of(vectors, [label for _, label in held])
    nearest = [
        rank_classes(measure.distances(measure.vector(item.signature.descriptors), vectors), shapes)[0].label
        if item.signature
        else None
        for item in queries
    ]
    return {"accuracy": nearest_class_accuracy(nearest, [str(item.file.label) for item in queries])}


def _table(figures: dict[str, dict[str, float]]) -> str:
    columns = list(next(iter(figures.values())))
    lines = [f"{'measure':<18}" + "".join(f"{column:>10}" for column in columns)]
    lines += [f"{name:<18}" + "".join(f"{row[column]:>10.3f}" for column in columns) for name, row in figures.items()]
    return "\n".join(lines)
