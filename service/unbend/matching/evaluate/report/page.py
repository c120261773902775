"""The HTML page of the report, rendered by a Jinja template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from unbend.arrays import Floats
from unbend.matching.evaluate.evaluation import Evaluation
from unbend.matching.evaluate.report.charts import (
    ClassMapChart,
    ConfusionChart,
    class_map_chart,
    confusion_chart,
    precision_recall_chart,
    separation_chart,
)
from unbend.matching.evaluate.report.pictures import ShapePicture, select_pictures
from unbend.matching.evaluate.separation import Clusters, Separation
from unbend.matching.evaluate.summary import ClassMetrics

_METRIC_NAMES: Final = {"nn": "NN", "ft": "FT", "st": "ST", "e": "E", "dcg": "DCG", "map": "mAP"}

_EXPLANATIONS: Final = {
    "nn": "nearest neighbour: the share of queries whose nearest shape belongs to their class",
    "ft": "first tier: the share of the C other shapes of the class that is among the C nearest",
    "st": "second tier: the share of the C other shapes of the class that is among the 2 C nearest",
    "e": "E-measure: the harmonic mean of precision and recall among the 32 nearest",
    "dcg": "discounted cumulative gain, divided by that of the ideal ranking",
    "map": "mean average precision",
}

# Names of files and classes are not trusted, so every value is escaped. A missing value is an error.
_TEMPLATES: Final = Environment(
    loader=PackageLoader("unbend.matching.evaluate.report"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


@dataclass(frozen=True)
class Report:
    """The content of the page."""

    title: str
    evaluations: Mapping[str, Evaluation]
    """The evaluation of each measure, all with the same queries and gallery."""
    queries: Sequence[str]
    """The name of each answered query, in the order of the evaluations' rows."""
    gallery: Sequence[str]
    """The name of each shape of the gallery; equal to `queries` with leave-one-out."""
    left_out: bool
    """Whether the evaluation is leave-one-out."""
    failures: Sequence[tuple[str, str]]
    """Files that could not be used, and the reasons."""
    settings: Mapping[str, object]
    """The parameters and policy of the signatures."""
    version: str
    """The version of unbend."""
    date: date
    maps: Mapping[str, Floats] = field(default_factory=dict)
    """Class maps of some of the measures: the points of the answered queries, (q, 2)."""
    clusters: Mapping[str, Clusters] = field(default_factory=dict)
    """The separation of classes under some of the measures."""
    separation: Separation | None = None
    """The separation of classes over the number of dimensions; None if it was not computed."""
    pictures: Sequence[ShapePicture] = ()
    """Pictures of shapes. The page shows a selection of them."""


@dataclass(frozen=True)
class WrongAnswer:
    """A query whose nearest shape belongs to another class."""

    query: str
    label: str
    nearest: str
    nearest_label: str
    distance: float


@dataclass(frozen=True)
class MeasureView:
    """The part of the page about one measure."""

    name: str
    evaluation: Evaluation
    confusion: ConfusionChart
    classes: Sequence[ClassMetrics]
    """Sorted by NN, the lowest first."""
    wrong: Sequence[WrongAnswer]


def render(report: Report) -> str:
    """Return the page as one HTML document that loads nothing else and runs no script."""
    curves = {name: evaluation.precision_recall for name, evaluation in report.evaluations.items()}
    separation = report.separation
    measures = [_view(name, evaluation, report) for name, evaluation in report.evaluations.items()]
    wrong = [[name for answer in view.wrong for name in (answer.query, answer.nearest)] for view in measures]
    return _TEMPLATES.get_template("page.html.jinja").render(
        report=report,
        plot=precision_recall_chart(curves),
        maps=[_class_map(name, points, report) for name, points in report.maps.items()],
        separation=separation_chart(separation.medians) if separation and separation.pairs else None,
        measures=measures,
        pictures=select_pictures(report.pictures, wrong),
        first=next(iter(report.evaluations.values())),
        metric_names=_METRIC_NAMES,
        explanations=_EXPLANATIONS,
        number=_number,
    )


def _class_map(name: str, points: Floats, report: Report) -> ClassMapChart:
    evaluation = report.evaluations[name]
    return class_map_chart(name, points, report.queries, [evaluation.labels[code] for code in evaluation.query_classes])


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
    return MeasureView(name, evaluation, confusion_chart(evaluation), sorted(evaluation.classes, key=_nn), wrong)


def _nn(row: ClassMetrics) -> tuple[float, str]:
    """Return the key that sorts by NN; classes without metrics come first."""
    return (row.metrics.nn if row.metrics else -1.0, row.label)
