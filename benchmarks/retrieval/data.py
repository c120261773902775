"""Labelled meshes of the data sets, their signatures, and the halving of classes."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import DATA
from unbend import Signature, Surface, geodesic_matrix
from unbend.errors import UnbendError
from unbend.jobs.batch import compute_paths
from unbend.jobs.limits import limit_process
from unbend.signature.parameters import Parameters
from unbend.threads import available_cores

DATASETS = ("shrec11_simplified", "tosca5k", "shrec07")

HUMANS = {"david", "michael", "victoria"}
"""The persons of TOSCA, which count as one class."""


def listed(dataset: str, *, merged: bool = True) -> tuple[list[Path], list[str]]:
    """Return the meshes of a data set and their classes; `merged` makes TOSCA's persons one class."""
    with (DATA / "labels.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["dataset"] == dataset]
    labels = ["human" if merged and row["class"] in HUMANS else row["class"].split("/")[-1] for row in rows]
    return [DATA / row["path"] for row in rows], labels


def signatures_of(paths: Sequence[Path], parameters: Parameters) -> list[Signature]:
    found = []
    for _, outcome in sorted(compute_paths(paths, parameters), key=itemgetter(0)):
        if isinstance(outcome, UnbendError):
            raise outcome
        found.append(outcome.signature)
    return found


def in_processes(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """Return the result of `function` for each item, computed on all cores."""
    with ProcessPoolExecutor(
        available_cores(), mp_context=get_context("spawn"), initializer=limit_process, initargs=(None,)
    ) as pool:
        return list(pool.map(function, items, chunksize=4))


def unit_distances(surface: Surface, signature: Signature) -> np.ndarray:
    """Return the geodesic distances between a signature's samples, scaled to a surface of area 1, (k, k)."""
    return geodesic_matrix(surface, signature.samples, threads=1) / np.sqrt(surface.area)


def half(labels: Sequence[str], which: int) -> np.ndarray[Any, np.dtype[np.bool]]:
    """Return a mask of the shapes in the first (0) or second (1) half of the classes, which alternate by name."""
    return np.isin(labels, sorted(set(labels))[which::2])
