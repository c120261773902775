"""Accuracy of classifiers, calibration of confidences, and detection of unknown classes.

Prints the constants for service/unbend/matching/classification/calibration.py. If that file has other constants, copy
the printed ones into it and run the benchmark again. Takes a few minutes. Writes the section "classification" of
docs/benchmarks/classification.md.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Final

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.retrieval import classification_cost
from benchmarks.retrieval.classification_constants import (
    CHOSEN_RULE,
    FORMS,
    LITERAL,
    OPEN_SIZES,
    RULES,
    choose_constant,
    choose_slack,
    constants,
    log_loss,
    rates,
    rule_values,
    sizes_for,
    summed,
)
from benchmarks.retrieval.classification_data import ALL, CHOOSING, REPORTING, Shapes, load, split, trials
from benchmarks.retrieval.data import half
from unbend.matching.classification import CLASSIFIERS, DEFAULT_CLASSIFIER, classify
from unbend.matching.classification.calibration import CALIBRATIONS
from unbend.matching.gallery import Gallery
from unbend.matching.measures import DEFAULT_MEASURE, VECTOR_MEASURES

DATASETS: Final = {"shrec11_simplified": "SHREC'11", "tosca5k": "TOSCA", "shrec07": "SHREC'07"}
SPLITS: Final = 20
TRAINED: Final = 10
"""Stored shapes per class; the other shapes of the class are queries."""
BINS: Final = (0.0, 0.5, 0.7, 0.9, 0.99, 0.999, 1.0)

Sets = tuple[Shapes, ...]
Answers = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Per query: confidence of the best class, whether the best class is correct, and confidence of the correct class."""


def main() -> None:
    sets = tuple(load(*named) for named in DATASETS.items())
    protocol = (
        "Half of the classes of each data set (every second class by name) chose the constants; the numbers are for"
        " queries of the other half. Libraries contain all classes. A library with a given number of shapes per class"
        " has these drawn at random, and the other shapes are queries; with all shapes, every shape is a query against"
        " all others. The classes of SHREC'07 contain different objects."
    )
    parts = [
        protocol,
        *_accuracies(sets[0]),
        *_forms(sets),
        *_calibrations(sets),
        *_reliability(sets),
        *_rules(sets),
        *_rule_of_each_measure(sets),
        *classification_cost.tables(sets[0].vectors[DEFAULT_MEASURE].shape[1]),
    ]
    write_section(BENCHMARKS / "classification.md", "classification", "\n\n".join(parts))
    found, stored = constants(sets), _stored_constants()
    print(f"\nConstants chosen in this run:\n{found}")
    print("These are in calibration.py." if found == stored else f"calibration.py has others:\n{stored}")


def _stored_constants() -> str:
    lines = []
    for measure in VECTOR_MEASURES:
        calibration = CALIBRATIONS[measure]
        exponents = ", ".join(f'"{name}": {calibration.exponents[name]:.2g}' for name in CLASSIFIERS)
        lines.append(f'"{measure}": Calibration({{{exponents}}}, {calibration.slack:.2f}),')
    return "\n".join(lines)


def _accuracies(shapes: Shapes) -> tuple[str, str]:
    rows = [
        [measure, name, *(f"{100 * share:.2f}" for share in _accuracy(shapes, measure, name))]
        for measure in VECTOR_MEASURES
        for name in CLASSIFIERS
    ]
    text = (
        f"**Accuracy** (%), {shapes.title}, {TRAINED} stored shapes a class, the others as queries, mean of {SPLITS}"
        f" random splits. The default is {DEFAULT_CLASSIFIER} with {DEFAULT_MEASURE}."
    )
    return text, table(["measure", "classifier", "all queries", "choosing half", "other half"], rows)


def _accuracy(shapes: Shapes, measure: str, classifier: str) -> tuple[float, float, float]:
    asked_labels, right = [], []
    vectors, labels = shapes.vectors[measure], shapes.labels
    for seed in range(SPLITS):
        held, asked = split(shapes, TRAINED, seed)
        gallery = Gallery.of(vectors[held], labels[held].tolist())
        for row in asked:
            distances = VECTOR_MEASURES[measure].distances(vectors[row], gallery.vectors)
            best = classify(gallery, VECTOR_MEASURES[measure], vectors[row], distances, classifier).matches[0]
            right.append(best.label == labels[row])
        asked_labels += labels[asked].tolist()
    found = np.array(right)
    first, second = (float(found[half(asked_labels, which)].mean()) for which in (CHOOSING, REPORTING))
    return float(found.mean()), first, second


def _forms(sets: Sets) -> tuple[str, str]:
    losses = [
        [measure, name, *(choose_constant(sets, measure, name, form)[1] for form in FORMS)]
        for measure in VECTOR_MEASURES
        for name in CLASSIFIERS
    ]
    means = np.mean([row[2:] for row in losses], axis=0)
    rows = [[*row[:2], *(f"{loss:.3f}" for loss in row[2:])] for row in [*losses, ["mean", "", *means]]]
    text = (
        "**Confidence, the choice**: log loss of the choosing halves under the best constant of each form, mean over"
        " the data sets and libraries of 1, 2, 4, 8 and all shapes a class (discriminants: from 2 on)."
    )
    return text, table(["measure", "classifier", *FORMS], rows)


@cache
def _answers(shapes: Shapes, measure: str, classifier: str, size: int | None) -> Answers:
    best, right, own = [], [], []
    for trial in trials(shapes, measure, size, REPORTING):
        query = trial.query
        matches = classify(query.gallery, query.measure, query.vector, query.distances, classifier).matches
        best.append(matches[0].confidence)
        right.append(matches[0].label == trial.label)
        own.append(next(match.confidence for match in matches if match.label == trial.label))
    return np.array(best), np.array(right), np.array(own)


def _calibrations(sets: Sets) -> tuple[str, str]:
    rows = []
    for measure in VECTOR_MEASURES:
        for name in CLASSIFIERS if measure == DEFAULT_MEASURE else (DEFAULT_CLASSIFIER,):
            for shapes in sets:
                for size in sizes_for(CLASSIFIERS[name], (1, 4, ALL)):
                    best, right, own = _answers(shapes, measure, name, size)
                    figures = right.mean(), best.mean(), _error(best, right), _by_chance(best), log_loss(own)
                    rows.append([measure, name, shapes.title, size or "all", *(f"{figure:.3f}" for figure in figures)])
    text = (
        "**Confidence**, other halves: share of right answers, mean confidence in the answers, expected calibration"
        " error (ten bins of equal width), the error that a perfectly calibrated confidence would have by chance on as"
        " many queries, and log loss."
    )
    header = [
        "measure",
        "classifier",
        "data",
        "shapes per class",
        "share correct",
        "confidence",
        "calibration error",
        "error by chance",
        "log loss",
    ]
    return text, table(header, rows)


def _error(best: np.ndarray, right: np.ndarray) -> float:
    bins = np.minimum((10 * best).astype(int), 9)
    return float(np.abs(np.bincount(bins, right - best, 10)).sum() / len(best))


def _by_chance(best: np.ndarray) -> float:
    generator = np.random.default_rng(0)
    return float(np.mean([_error(best, generator.random(len(best)) < best) for _ in range(200)]))


def _reliability(sets: Sets) -> tuple[str, str]:
    answers = {
        f"{shapes.title}, {size or 'all'} a class": _answers(shapes, DEFAULT_MEASURE, DEFAULT_CLASSIFIER, size)
        for shapes in sets
        for size in (1, ALL)
    }
    rows = []
    for low, high in pairwise(BINS):
        shares = []
        for best, right, _ in answers.values():
            inside = (best >= low) & ((best < high) | (high == BINS[-1]))
            shares.append(f"{right[inside].mean():.3f} of {inside.sum()}" if inside.any() else "-")
        rows.append([f"{low} to {high}", *shares])
    text = (
        f"**Reliability** of {DEFAULT_CLASSIFIER} with {DEFAULT_MEASURE}, other halves: share of right answers by their"
        " confidence."
    )
    return text, table(["confidence", *answers], rows)


def _rules(sets: Sets) -> tuple[str, str]:
    rows = []
    for rule in RULES:
        slack = choose_slack(sets, DEFAULT_MEASURE, rule)
        for constant in (1.0, slack) if rule in LITERAL else (slack,):
            chose = summed(sets, DEFAULT_MEASURE, rule, constant)
            rows.append([rule, f"{constant:.2f}", f"{chose:.3f}", *_refused(sets, DEFAULT_MEASURE, rule, constant)])
    text = (
        "**Unknown**, other halves: false rejects (unknown, although the class is in the library) / false accepts"
        f" (known, although the class was left out), in % of queries, for {DEFAULT_MEASURE}, by shapes a class. A query"
        " is known if its distance from the nearest member is at most a constant times the largest, mean or median"
        " distance of members to their nearest other members. The literal rule is the largest distance with a constant"
        " of 1.00. Each constant has the least sum of both rates on the choosing halves,"
        f" mean over data sets and libraries of {', '.join(str(size or 'all') for size in OPEN_SIZES)} a class."
        f" In use: {CHOSEN_RULE}."
    )
    return text, table(["rule", "constant", "sum, choosing halves", *_columns(sets)], rows)


def _rule_of_each_measure(sets: Sets) -> tuple[str, str]:
    rows = []
    for measure in VECTOR_MEASURES:
        slack = choose_slack(sets, measure, CHOSEN_RULE)
        rows.append([measure, f"{slack:.2f}", *_refused(sets, measure, CHOSEN_RULE, slack)])
    return f"The same for every measure: {CHOSEN_RULE}.", table(["measure", "constant", *_columns(sets)], rows)


def _columns(sets: Sets) -> list[str]:
    return [f"{shapes.title}, {size or 'all'}" for shapes in sets for size in OPEN_SIZES]


def _refused(sets: Sets, measure: str, rule: str, constant: float) -> list[str]:
    asked = [rule_values(shapes, measure, rule, size, REPORTING) for shapes in sets for size in OPEN_SIZES]
    return [
        " / ".join(f"{100 * rate:.1f}" for rate in rates(some, constant)) if all(map(len, some)) else "-"
        for some in asked
    ]


if __name__ == "__main__":
    main()
