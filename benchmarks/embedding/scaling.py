"""Scaling compared with other libraries: time, stress, iterations, effective dimensions, and the time of a signature.

Every method runs in one thread, except that whole forms use all threads. The methods take turns, and the quickest turn
counts. Writes the section "embedding" of docs/benchmarks/embedding.md.
"""

from __future__ import annotations

import os
import warnings
from importlib.metadata import version

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from s_gd2 import mds_direct
from scipy.linalg import eigh
from sklearn.manifold import ClassicalMDS
from sklearn.manifold import smacof as sklearn_smacof

from benchmarks.common import BENCHMARKS, DATA, in_turns, table, write_section
from benchmarks.embedding.meshes import matrices_of_meshes, matrices_of_others, matrix_of
from benchmarks.embedding.studies import acceleration_table, dimension_table, minima_table, order_table
from benchmarks.embedding.surfaces import surface_table
from benchmarks.embedding.whole import form_table, signature_table
from unbend.embedding.classical import classical_scaling, inner_products
from unbend.embedding.gradient import StressGradient
from unbend.embedding.least_squares import smacof
from unbend.embedding.stress import stress
from unbend.threads import Team

Array = np.ndarray

LARGE = 1000


def main() -> None:
    matrices = dict(matrices_of_meshes())
    parts = [
        "One thread. Versions: " + ", ".join(f"{name} {version(name)}" for name in ("scikit-learn", "s_gd2", "scipy")),
        _peers(),
        acceleration_table(matrices),
        order_table(matrices),
        minima_table(dict(matrices_of_others())),
        dimension_table(matrices),
        surface_table(),
        signature_table(),
        form_table(),
    ]
    write_section(BENCHMARKS / "embedding.md", "embedding", "\n\n".join(parts))


def _peers() -> str:
    distances = matrix_of(DATA / "single" / "human_man.obj", LARGE)
    start = classical_scaling(distances, 3)[0]
    gradient, axes = StressGradient(distances, None, single=True, team=Team(1)), np.ascontiguousarray(start.T)
    warnings.simplefilter("ignore", FutureWarning)
    upper = distances[np.triu_indices(LARGE, 1)]

    def theirs(iterations: int, eps: float) -> tuple[Array, int]:
        points, _, made = sklearn_smacof(
            distances, n_components=3, init=start, n_init=1, max_iter=iterations, eps=eps,
            normalized_stress=False, return_n_iter=True,
        )  # fmt: skip
        return points, made

    def sgd() -> tuple[Array, int]:
        steps = np.geomspace(1.0, 0.01, 30)
        return mds_direct(LARGE, upper, w=np.ones_like(upper), etas=steps, num_dimensions=3, random_seed=0), 30

    found = in_turns(
        {
            "one": lambda: gradient(axes),
            "ten": lambda: theirs(10, 0.0),
            "ours": lambda: smacof(distances, classical_scaling(distances, 3)[0], threads=1),
            "early": lambda: smacof(distances, classical_scaling(distances, 3)[0], decrease=1e-4, threads=1),
            "plain": lambda: smacof(distances, classical_scaling(distances, 3)[0], memory=0, threads=1),
            "theirs": lambda: theirs(300, 1e-6),
            "sgd": sgd,
            "classical": lambda: classical_scaling(distances, 3),
            "ClassicalMDS": lambda: ClassicalMDS(n_components=3, metric="precomputed").fit(distances),
            "eigh": lambda: eigh(
                inner_products(distances**2, np.full(LARGE, 1 / LARGE)), subset_by_index=[LARGE - 3, LARGE - 1]
            ),
        }
    )
    seconds = {name: of[0] for name, of in found.items()}
    fits = [
        ("unbend, accelerated", "ours"), ("unbend, accelerated, to 1e-4", "early"),
        ("unbend, SMACOF", "plain"), ("scikit-learn smacof", "theirs"),
        ("s_gd2, 30 rounds, no start", "sgd"),
    ]  # fmt: skip
    rows = [
        [name, f"{1e3 * seconds[key]:.0f}", f"{seconds[key] / seconds['ours']:.1f}", found[key][1][1],
         f"{stress(np.ascontiguousarray(found[key][1][0]), distances):.6f}"]
        for name, key in fits
    ]  # fmt: skip
    dense = eigh(inner_products(distances**2, np.full(LARGE, 1 / LARGE)), eigvals_only=True)[:-4:-1]
    error = np.abs(found["classical"][1][1] / dense - 1).max()
    classical = [
        [name, f"{1e3 * seconds[key]:.1f}", f"{seconds[key] / seconds['classical']:.1f}"]
        for name, key in (("unbend", "classical"), ("scipy eigh, 3 vectors", "eigh"), ("ClassicalMDS", "ClassicalMDS"))
    ]
    ratio = seconds["ten"] / 10 / seconds["one"]
    return (
        f"**{LARGE} samples** of human_man, m = 3. One iteration of least squares: {1e3 * seconds['one']:.2f} ms, of"
        f" scikit-learn {1e2 * seconds['ten']:.1f} ms, {ratio:.0f} times as much. A whole fit; our time"
        " includes the classical start, and scikit-learn gets that start:\n\n"
        + table(["method", "ms", "times ours", "iterations", "stress"], rows)
        + f"\n\nClassical scaling; our three eigenvalues differ from a dense solver's by at most {error:.0e} of them:"
        "\n\n" + table(["method", "ms", "times ours"], classical)
    )


if __name__ == "__main__":
    main()
