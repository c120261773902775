"""The page: a Jinja template filled with values that are ready to be drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import date
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from unbend.arrays import Floats
from unbend.matching.evaluate.evaluation import ClassFigures, Evaluation
from unbend.matching.evaluate.figures import RetrievalFigures
from unbend.matching.evaluate.report.heatmap import HeatMap, heat_map
from unbend.matching.evaluate.report.lines import lines
from unbend.matching.evaluate.report.plot import plot
from unbend.matching.evaluate.report.scatter import Scatter, scatter
from unbend.matching.evaluate.separation import Clusters, Separation

FIGURE_NAMES: Final = {"nn": "NN", "ft": "FT", "st": "ST", "e": "E", "dcg": "DCG", "map": "mAP"}

# Names of files and classes are anybody's: all that is filled in is escaped, and what is missing is an error.
_TEMPLATES: Final = Environment(
    loader=PackageLoader("unbend.matching.evaluate.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


@dataclass(frozen=True)
class Report:
    """What the page tells."""

    title: str
    evaluations: Mapping[str, Evaluation]
    """By measure; all of the same queries and gallery."""
    queries: Sequence[str]
    """What each query is called, in the order of its row."""
    gallery: Sequence[str]
    """The same of the gallery's shapes; with leave-one-out those of `queries`."""
    left_out: bool
    """Whether each query was left out of the gallery: leave-one-out."""
    failures: Sequence[tuple[str, str]]
    """Files that could not be used, and why."""
    settings: Mapping[str, object]
    """What the signatures were computed with."""
    version: str
    """Of unbend."""
    date: date
    maps: Mapping[str, Floats] = field(default_factory=dict)
    """Places of the queries that have an answer by measure, (q, 2): class maps. May be left out."""
    clusters: Mapping[str, Clusters] = field(default_factory=dict)
    """How far classes are apart by measure. May be left out."""
    separation: Separation | None = None
    """How far they are apart over the number of dimensions. May be left out."""


@dataclass(frozen=True)
class WrongAnswer:
    """A query whose nearest shape is of another class."""

    query: str
    label: str
    nearest: str
    nearest_label: str
    distance: float


@dataclass(frozen=True)
class MeasureView:
    """What is shown of one measure."""

    name: str
    evaluation: Evaluation
    heat_map: HeatMap
    classes: Sequence[ClassFigures]
    """Those with the lowest NN first."""
    wrong: Sequence[WrongAnswer]


def render(report: Report) -> str:
    """Return the page: one HTML document that loads nothing else and runs no script."""
    curves = {name: evaluation.precision_recall for name, evaluation in report.evaluations.items()}
    return _TEMPLATES.get_template("page.html.jinja").render(
        report=report,
        plot=plot(curves),
        maps=[_scatter(name, points, report) for name, points in report.maps.items()],
        separation=lines(report.separation.medians) if report.separation and report.separation.pairs else None,
        measures=[_view(name, evaluation, report) for name, evaluation in report.evaluations.items()],
        first=next(iter(report.evaluations.values())),
        figure_names=FIGURE_NAMES,
        explanations={field.name: _EXPLANATIONS[field.name] for field in fields(RetrievalFigures)},
        number=_number,
    )


_EXPLANATIONS: Final = {
    "nn": "nearest neighbour: how often the nearest shape is of the query's class",
    "ft": "first tier: the share of the C other shapes of the class that is among the C nearest",
    "st": "second tier: the same among the 2 C nearest",
    "e": "E-measure: the harmonic mean of precision and recall among the 32 nearest",
    "dcg": "discounted cumulative gain, over that of the ideal ranking",
    "map": "mean average precision",
}


def _scatter(name: str, points: Floats, report: Report) -> Scatter:
    evaluation = report.evaluations[name]
    return scatter(name, points, report.queries, [evaluation.labels[code] for code in evaluation.query_classes])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _view(name: str, evaluation: Evaluation, report: Report) -> MeasureView:
    labels = evaluation.labels
    wrong = [
        WrongAnswer(
            query=report.queries[query],
            label=labels[evaluation.query_classes[query]],
            nearest=report.gallery[evaluation.nearest[query]],
            nearest_label=labels[evaluation.nearest_classes[query]],
            distance=float(evaluation.nearest_distances[query]),
        )
        for query in evaluation.wrong
    ]
    return MeasureView(name, evaluation, heat_map(evaluation), sorted(evaluation.classes, key=_nn), wrong)


def _nn(row: ClassFigures) -> tuple[float, str]:
    """Sort by NN; classes that can find nothing come first."""
    return (row.figures.nn if row.figures else -1.0, row.label)
