"""Figs. 6 to 8: classes of bent shapes, their signatures, and how well moments separate them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import permutations, product

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from benchmarks.common import table
from benchmarks.paper.draw import Array, head_columns, paint, panels, plt, procrustes, save, turn_of
from benchmarks.paper.meshes import listed
from unbend import Parameters, Signature, Surface, compute_signature, embed, read_mesh
from unbend.matching.evaluate import clusters
from unbend.mesh.shapes import cone, cylinder, figure, s_bend, sheet, spiral
from unbend.signature.canonical_form import canonical_form

SAMPLES = 300
POSES = 6
SHOWN = (0, 2, 4)

SIDE = turn_of(60, 14)
ABOVE = turn_of(-55, 40)

BENT_SHEETS: tuple[Callable[[], Surface], ...] = (
    sheet,
    lambda: cylinder(math.pi),
    lambda: s_bend(math.pi),
    lambda: cylinder(1.8 * math.pi),
    lambda: spiral(1.5, 0.1),
    lambda: s_bend(1.6 * math.pi),
)

BODIES = {
    "human": "biped",
    "dog": "quadruped",
    "giraffe": "giraffe",
    "hand": "hand",
    "bird": "bird",
    "spider": "spider",
}

REAL = ("dinosaur", "dino_ske", "man", "hand", "dog1", "camel", "laptop", "rabbit")


@dataclass(frozen=True)
class Class:
    """Bendings of one shape, and the direction from which they are drawn."""

    label: str
    surfaces: list[Surface]
    turn: Array


@cache
def generated() -> list[Class]:
    """Return eight classes like the paper's, each in six bendings."""
    classes = [Class(label, [figure(kind, pose) for pose in range(POSES)], SIDE) for label, kind in BODIES.items()]
    hats = [cone(roll=float(roll)) for roll in np.linspace(0, 1, POSES)]
    return [*classes, Class("hat", hats, ABOVE), Class("paper", [bent() for bent in BENT_SHEETS], ABOVE)]


@cache
def signatures_of_generated() -> list[list[Signature]]:
    return [[_signature(surface) for surface in of.surfaces] for of in generated()]


def figures_6_and_7() -> None:
    inputs, input_grid = panels(len(SHOWN), len(generated()), (16, 6.2))
    outputs, output_grid = panels(len(SHOWN), len(generated()), (16, 6.2))
    for column, (of, signatures) in enumerate(zip(generated(), signatures_of_generated(), strict=True)):
        colour = _colours()[column]
        forms = _forms(of, signatures)
        for row, pose in enumerate(SHOWN):
            paint(input_grid[row, column], of.surfaces[pose], of.turn, colour, size=260)
            paint(output_grid[row, column], forms[row], of.turn, colour, size=260)
    for page, grid, name in ((inputs, input_grid, "paper-fig6"), (outputs, output_grid, "paper-fig7")):
        head_columns(grid, (of.label for of in generated()))
        save(page, name, dpi=75)


def _forms(of: Class, signatures: list[Signature]) -> list[Surface]:
    """Return the signatures of the drawn poses; the first is aligned with its surface, the others with the first."""
    forms: list[Surface] = []
    for pose in SHOWN:
        surface = of.surfaces[pose]
        points = canonical_form(surface, signature=signatures[pose]).points
        onto = _nearest_turn(points, forms[0].vertices) if forms else procrustes(points, surface.vertices)
        forms.append(Surface(points @ onto, surface.faces))
    return forms


def _nearest_turn(points: Array, others: Array) -> Array:
    """Return the rotation or reflection that brings `points` nearest to `others`.

    It maps principal axes to principal axes; all orders and signs of the axes are tried.
    """
    others = others - others.mean(axis=0)
    axes = np.linalg.svd(others, full_matrices=False)[2]
    centred, tree = points - points.mean(axis=0), cKDTree(others)
    own = np.linalg.svd(centred, full_matrices=False)[2].T
    mixes = product(permutations(range(3)), product((1, -1), repeat=3))
    turns = [own @ (np.eye(3)[list(order)] * np.array(signs)) @ axes for order, signs in mixes]
    return min(turns, key=lambda turn: float((tree.query(centred @ turn)[0] ** 2).mean()))


def figure_8() -> str:
    rows_of = {"generated": _generated_vectors(), "SHREC'11": _real_vectors()}
    page, grid = plt.subplots(len(rows_of), 2, figsize=(13, 8.4), layout="constrained")
    rows = []
    for axes, (name, (labels, before, after)) in zip(grid, rows_of.items(), strict=True):
        _draw_map(axes[0], f"{name}: original surfaces", labels, before)
        _draw_map(axes[1], f"{name}: signatures", labels, after)
        axes[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
        for what, vectors in (("original surfaces", before), ("signatures", after)):
            found = clusters(cdist(vectors, vectors), labels)
            title = f"{name} ({len(labels)} in {len(set(labels))})"
            rows.append([title, what, f"{100 * found.nearest:.0f} %", f"{found.ratio:.1f}"])
    save(page, "paper-fig8", dpi=75)
    return table(["shapes", "moments of", "correct nearest neighbours", "between / within"], rows)


def _generated_vectors() -> tuple[list[str], Array, Array]:
    labels = [of.label for of in generated() for _ in of.surfaces]
    return labels, *_vectors([signature for of in signatures_of_generated() for signature in of])


def _real_vectors() -> tuple[list[str], Array, Array]:
    found = [(label, _signature(read_mesh(path))) for label in REAL for path in listed("shrec11_simplified", label)]
    return [label for label, _ in found], *_vectors([signature for _, signature in found])


def _vectors(signatures: list[Signature]) -> tuple[Array, Array]:
    before = np.stack([signature.surface_moments for signature in signatures])
    return before, np.stack([signature.moments for signature in signatures])


def _signature(surface: Surface) -> Signature:
    return compute_signature(surface, Parameters(samples=SAMPLES))


def _draw_map(axes: plt.Axes, title: str, labels: list[str], vectors: Array) -> None:
    """Draw one point for each shape, by MDS of the distances between the vectors: the roots of D_M (section 2.3)."""
    places = embed(cdist(vectors, vectors), 2).points
    for number, label in enumerate(dict.fromkeys(labels)):
        own = places[[label == other for other in labels]]
        marker = "osD^vP*X"[number]
        axes.scatter(*own.T, 80, _colours()[[number]], marker, label=label, edgecolors="white", linewidths=0.5)
    axes.set(title=title, xticks=[], yticks=[], aspect="equal", adjustable="datalim")
    axes.spines[:].set_color("0.8")


def _colours() -> Array:
    return plt.get_cmap("tab10")([0, 1, 2, 3, 4, 5, 8, 9])[:, :3]
