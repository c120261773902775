"""`unbend evaluate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from click.core import ParameterSource

from unbend.cli.folders.computing import Machine, machine_options
from unbend.cli.options import (
    VECTOR_MEASURES,
    Values,
    json_option,
    label_from_option,
    measure_option,
    parameter_options,
    place_options,
    policy_options,
)
from unbend.cli.places import open_place
from unbend.cli.tables import figures_table
from unbend.cli.terminal import print_result

if TYPE_CHECKING:
    from unbend.matching.evaluate import Clusters, Separation

_CSV = click.Path(exists=True, dir_okay=False, path_type=Path)
_PAGE = click.Path(dir_okay=False, writable=True, path_type=Path)
_METRICS: Final = ("nn", "ft", "st", "e", "dcg", "map")


@click.command()
@click.argument(
    "folder", metavar="[DIR]", required=False, type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@click.option("--labels", type=_CSV, help="CSV with the columns path (relative to DIR) and class.")
@label_from_option
@place_options
@measure_option(
    VECTOR_MEASURES, "measures", multiple=True, description="A measure to evaluate; may be repeated. All by default."
)
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
@click.pass_context
def evaluate(
    context: click.Context,
    /,
    folder: Path | None,
    labels: Path | None,
    label_from: str | None,
    library: str,
    url: str | None,
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
    """Measure retrieval on the labelled shapes of DIR, of a library, or of a running service.

    By default every shape is a query against all others (leave-one-out). With --gallery, the result is the share of
    shapes whose nearest class in the gallery is right. Unusable files are printed on standard error. With
    --gallery, unusable queries count as wrong.

    Without DIR, the shapes of --library or --url that were computed with the given parameters take part.
    """
    _check_options(context, folder, labels, label_from)
    chosen = measures or VECTOR_MEASURES
    separations = None
    if folder is None:
        with open_place(library, url) as place:
            results = {name: place.evaluation(name, parameters=parameters).as_dict() for name in chosen}
    else:
        from unbend.cli.folders.evaluation import Folder, evaluate_folder  # noqa: PLC0415

        found = evaluate_folder(
            Folder(folder, labels, gallery), chosen, machine, parameters, policy, separated=separated, html=html
        )
        results = {name: result.as_dict() for name, result in found.evaluations.items()}
        separations = found.separations
    columns = _METRICS if gallery is None else ("accuracy", *_METRICS)
    document = {name: result if per_class else _figures(result, gallery) for name, result in results.items()}
    if separations:
        document["separation"] = {name: asdict(of) for name, of in separations[0].items()} | {
            "dimensions": separations[1].as_dict()
        }
    print_result(document, lambda: _text(results, columns, per_class, separations), as_json=as_json)


_OF_FOLDERS: Final = ("labels", "label_from", "gallery", "separated", "html", "workers", "memory_mb")
"""Options that only folders have. The records of a library have the classes and the policies."""


def _check_options(context: click.Context, folder: Path | None, labels: Path | None, label_from: str | None) -> None:
    """Raise UsageError if the options do not go with the source of the shapes."""
    given = {
        parameter.name: parameter.opts[0]
        for parameter in context.command.params
        if parameter.name and context.get_parameter_source(parameter.name) is ParameterSource.COMMANDLINE
    }
    if folder is None:
        policies = {str(option) for option in context.params["policy"]}
        if wrong := [flag for name, flag in given.items() if name in policies.union(_OF_FOLDERS)]:
            raise click.UsageError(f"{wrong[0]} needs DIR")
    elif wrong := [flag for name, flag in given.items() if name in {"library", "url"}]:
        raise click.UsageError(f"DIR and {wrong[0]} exclude each other")
    elif (labels is None) == (label_from is None):
        raise click.UsageError("DIR needs either --labels or --label-from")


def _figures(result: Values, gallery: Path | None) -> Values:
    if gallery is None and result["nn"] is not None:
        return {name: result[name] for name in _METRICS}
    return {"accuracy": result["accuracy"]}


def _text(
    results: Mapping[str, Values],
    columns: tuple[str, ...],
    per_class: bool,
    separations: tuple[dict[str, Clusters], Separation] | None,
) -> str:
    tables = [figures_table("measure", columns, list(results.items()))]
    if per_class:
        tables += [
            figures_table(name, ["queries", "members", *columns], [(row["label"], row) for row in result["classes"]])
            for name, result in results.items()
        ]
    if separations:
        tables.append(_tables_of_separation(*separations))
    return "\n\n".join(tables)


def _tables_of_separation(by_measure: Mapping[str, Clusters], over: Separation) -> str:
    rows: list[tuple[str, Any]] = [(name, asdict(of)) for name, of in by_measure.items()]
    first = figures_table("measure", ["nearest", "ratio"], rows)
    if not over.pairs:
        return f"{first}\n\nno two classes have two shapes each: there is no separation by dimensions"
    medians = over.medians
    columns = [f"m = {m}" for m in range(1, 1 + max(map(len, medians.values())))]
    by_method: list[tuple[str, Any]] = [
        (str(method), dict(zip(columns, of, strict=True))) for method, of in medians.items()
    ]
    return f"{first}\n\n{figures_table('log ratio', columns, by_method)}"
