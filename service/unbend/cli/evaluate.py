"""`unbend evaluate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from click.core import ParameterSource

from unbend.brief import counted
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
from unbend.cli.places import Place, open_place
from unbend.cli.reasons import why_nothing_is_evaluated
from unbend.cli.tables import figures_table
from unbend.cli.terminal import print_result
from unbend.errors import UnsuitedError

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

    The figures are means over queries. C is the number of other shapes of the class of the query. All but e are 1 if
    these come first.

    \b
    accuracy  with --gallery: the share of queries whose nearest shape has
              their class, and queries that fail count as wrong
    nn        nearest neighbour: the share of queries whose nearest shape has
              their class
    ft, st    first and second tier: the share of these C shapes that is among
              the C nearest, and among the 2 C nearest
    e         E-measure: the harmonic mean of precision and recall among the
              32 nearest. It is at most 2 C / (32 + C), which is small in
              a library of small classes, however good the ranking is
    dcg       discounted cumulative gain: the further down a shape of the
              class is, the less it counts
    map       mean average precision: how many of the shapes before each shape
              of the class belong to the class
    """  # noqa: D301  click needs the character, not two
    _check_options(context, folder, labels, label_from)
    chosen = measures or VECTOR_MEASURES
    separations = None
    if folder is None:
        with open_place(library, url) as place:
            results = {name: _evaluation(place, name, parameters) for name in chosen}
    else:
        from unbend.cli.folders.evaluation import Folder, evaluate_folder  # noqa: PLC0415

        found = evaluate_folder(
            Folder(folder, labels, gallery), chosen, machine, parameters, policy, separated=separated, html=html
        )
        results = {name: result.as_dict() for name, result in found.evaluations.items()}
        separations = found.separations
    document = {name: result if per_class else _figures(result, gallery) for name, result in results.items()}
    if separations:
        document["separation"] = {name: asdict(of) for name, of in separations[0].items()} | {
            "dimensions": separations[1].as_dict()
        }
    print_result(document, lambda: _text(results, gallery is not None, per_class, separations), as_json=as_json)


def _evaluation(place: Place, measure: str, parameters: Values) -> Values:
    """Return an evaluation of `place`. An error names its true reason, such as other parameters."""
    try:
        return place.evaluation(measure, parameters=parameters).as_dict()
    except UnsuitedError as error:
        raise why_nothing_is_evaluated(place, parameters, measure) or error from None


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
    has_gallery: bool,
    per_class: bool,
    separations: tuple[dict[str, Clusters], Separation] | None,
) -> str:
    columns = ("accuracy", *_METRICS) if has_gallery else _METRICS
    texts = [
        _sentence(*next(iter(results.items())), has_gallery),
        figures_table("measure", columns, list(results.items())),
    ]
    if per_class:
        texts += [
            figures_table(name, ["queries", "members", *columns], [(row["label"], row) for row in result["classes"]])
            for name, result in results.items()
        ]
    if separations:
        texts.append(_tables_of_separation(*separations))
    return "\n\n".join(texts)


def _sentence(measure: str, result: Values, has_gallery: bool) -> str:
    """Return in words how many nearest shapes have the class of their query."""
    rows = result["classes"]
    counted_rows = rows if has_gallery else [row for row in rows if row["members"] > 1]
    right = sum(round(row["accuracy"] * row["queries"]) for row in counted_rows)
    queries = sum(row["queries"] for row in counted_rows)
    alone = sum(row["queries"] for row in rows) - queries
    left_out = f", without {counted(alone, 'shape')} alone in a class" if alone else ""
    return f"{measure}: {right} of {queries} nearest shapes have the class of the query{left_out}"


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
