"""Chooses the constants of service/unbend/matching/classification/calibration.py from the data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from benchmarks.retrieval.classification_data import ALL, CHOOSING, Shapes, Trial, trials
from unbend.matching.classification import CLASSIFIERS, discriminants
from unbend.matching.classification.calibration import confidences, spacing
from unbend.matching.classification.classifier import Classifier, Query
from unbend.matching.measures import VECTOR_MEASURES

SIZES: Final = (1, 2, 4, 8, ALL)
"""Shapes per class of the libraries; every size has the same weight."""

MIN_MEMBERS: Final = {"discriminants": discriminants.MIN_MEMBERS}
"""Shapes per class that a classifier needs, if more than one."""

Array = np.ndarray
Judged = tuple[Array, Array]
"""Dissimilarities of each query and class, (queries, classes), and the index of the correct class, (queries,)."""


def softmax(dissimilarities: Array, scale: float) -> Array:
    shares = np.exp(-scale * (dissimilarities - dissimilarities.min(axis=1, keepdims=True)))
    return shares / shares.sum(axis=1, keepdims=True)


def softmax_of_ratios(dissimilarities: Array, scale: float) -> Array:
    return softmax(
        dissimilarities / np.maximum(dissimilarities.min(axis=1, keepdims=True), np.finfo(float).tiny), scale
    )


FORMS: Final[Mapping[str, Callable[[Array, float], Array]]] = {
    "power": confidences,
    "softmax": softmax,
    "softmax of ratios": softmax_of_ratios,
}
"""Functions from dissimilarities and one constant to probabilities."""


def judge(classifier: Classifier, asked: Sequence[Trial]) -> Judged:
    dissimilarities = np.array([classifier.score(trial.query).dissimilarities for trial in asked])
    return dissimilarities, np.array([trial.query.gallery.labels.index(trial.label) for trial in asked])


def sizes_for(classifier: Classifier, sizes: Sequence[int | None] = SIZES) -> list[int | None]:
    return [size for size in sizes if size is ALL or size >= MIN_MEMBERS.get(classifier.name, 1)]


@cache
def choosing(sets: tuple[Shapes, ...], measure: str, classifier: str) -> list[Judged]:
    """Return the dissimilarities for the queries of the choosing halves, for each data set and size of library."""
    chosen = CLASSIFIERS[classifier]
    asked = (trials(shapes, measure, size, CHOOSING) for shapes in sets for size in sizes_for(chosen))
    return [judge(chosen, some) for some in asked if some]


def log_loss(shares: Array) -> float:
    return -float(np.log(np.maximum(shares, np.finfo(float).tiny)).mean())


@cache
def choose_constant(sets: tuple[Shapes, ...], measure: str, classifier: str, form: str) -> tuple[float, float]:
    """Return the constant of the least log loss, and that loss, as a mean over data sets and sizes."""

    def loss(logarithm: float) -> float:
        constant = float(np.exp(logarithm))
        judged = (
            (FORMS[form](dissimilarities, constant), own)
            for dissimilarities, own in choosing(sets, measure, classifier)
        )
        return float(np.mean([log_loss(shares[np.arange(len(own)), own]) for shares, own in judged]))

    found = minimize_scalar(loss, bounds=np.log([1e-3, 1e4]), method="bounded", options={"xatol": 1e-3})
    return float(np.exp(found.x)), float(found.fun)


# Rules of "known": a query's distance to a class, divided by the members' distances to their nearest other members.


def _best(query: Query) -> int:
    return int(query.nearest.argmin())


def _of_best(statistic: Callable[[Array], float], query: Query) -> float:
    near, own = spacing(query, _best(query))
    return near / statistic(own)


def _of_any(statistic: Callable[[Array], float], query: Query) -> float:
    spacings = [spacing(query, int(code)) for code in np.flatnonzero(query.nearest < np.inf)]
    return min(near / statistic(own) for near, own in spacings if len(own))


def _pooled(statistic: Callable[[Array], float], query: Query) -> float:
    own = [spacing(query, int(code))[1] for code in np.flatnonzero(query.nearest < np.inf)]
    return float(query.nearest.min()) / statistic(np.concatenate(own))


RULES: Final[Mapping[str, Callable[[Query], float]]] = {
    "largest, best class": partial(_of_best, np.max),
    "largest, any class": partial(_of_any, np.max),
    "largest, all classes pooled": partial(_pooled, np.max),
    "mean, best class": partial(_of_best, np.mean),
    "mean, any class": partial(_of_any, np.mean),
    "mean, all classes pooled": partial(_pooled, np.mean),
    "median, best class": partial(_of_best, np.median),
}
CHOSEN_RULE: Final = "mean, best class"
LITERAL: Final = ("largest, best class", "largest, any class")
OPEN_SIZES: Final = (2, 4, 8, ALL)

RuleValues = tuple[Array, Array]
"""Values of a rule for queries whose class is in the library, and for queries whose class is not."""


@cache
def rule_values(shapes: Shapes, measure: str, rule: str, size: int | None, which: int) -> RuleValues:
    """Return the values of a rule, except for queries whose best class has a single member (no rule applies)."""
    known, unknown = (
        np.array(
            [
                RULES[rule](trial.query)
                for trial in trials(shapes, measure, size, which, known=there)
                if len(spacing(trial.query, _best(trial.query))[1])
            ]
        )
        for there in (True, False)
    )
    return known, unknown


def rates(some: RuleValues, constant: float) -> tuple[float, float]:
    """Return the shares of false rejects and of false accepts."""
    return float((some[0] > constant).mean()), float((some[1] <= constant).mean())


def summed(sets: tuple[Shapes, ...], measure: str, rule: str, constant: float) -> float:
    """Return the sum of both rates on the choosing halves, a mean over data sets and sizes."""
    some = [rule_values(shapes, measure, rule, size, CHOOSING) for shapes in sets for size in OPEN_SIZES]
    return float(np.mean([sum(rates(one, constant)) for one in some if all(map(len, one))]))


@cache
def choose_slack(sets: tuple[Shapes, ...], measure: str, rule: str) -> float:
    """Return the constant with the least sum; among several equally good ones, the middle one."""
    grid = np.linspace(0.2, 3.0, 281)
    sums = np.array([summed(sets, measure, rule, constant) for constant in grid])
    best = np.flatnonzero(sums == sums.min())
    return float(grid[best[len(best) // 2]])


def constants(sets: tuple[Shapes, ...]) -> str:
    """Return the table of calibration.py as Python code."""
    lines = []
    for measure in VECTOR_MEASURES:
        exponents = ", ".join(
            f'"{name}": {choose_constant(sets, measure, name, "power")[0]:.2g}' for name in CLASSIFIERS
        )
        lines.append(f'"{measure}": Calibration({{{exponents}}}, {choose_slack(sets, measure, CHOSEN_RULE):.2f}),')
    return "\n".join(lines)
