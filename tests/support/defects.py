"""Small surfaces with random defects, and checks that each gives correct distances or a typed error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from hypothesis import strategies as st

from tests.support.oracles import TooManyWindowsError, edge_path_distances, grid, soup_distances, steiner_distances
from unbend import Surface, geodesic_distances
from unbend.errors import MeshError
from unbend.geodesics.stencils import stencils_of
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.repair import repair
from unbend.mesh.shapes import bent_tube, cylinder, sphere, torus

DETOUR: Final = 0.1
"""Share by which a distance may exceed the shortest path along edges, because marching does not use all edges."""

NOTHING: Final = 1e-4
"""Share of a typical edge below which a length counts as zero: `flips.mollified` gives such edges a tiny length."""

SHORTFALL: Final = 1e-9
"""Tolerance for rounding in a chain of some dozens of updates."""

UPDATES: Final = ("spherical", "planar")


@dataclass(frozen=True)
class Mesh:
    """Raw arrays, and the names of the base and of the defects applied to it."""

    vertices: np.ndarray
    faces: np.ndarray
    story: tuple[str, ...]


Arrays = tuple[np.ndarray, np.ndarray]
Defect = Callable[[np.ndarray, np.ndarray, np.random.Generator], Arrays]

BASES: Final = {
    "sphere": lambda: sphere(subdivisions=1),
    "torus": lambda: torus(columns=9, rows=6),
    "cylinder": lambda: cylinder(columns=8, rows=5),
    "grid": lambda: grid(7, 5, 0.4),
    "tube": lambda: bent_tube(length=1.5, radius=0.3, around=6, along=4),
}


def _some(rng: np.random.Generator, count: int, most: int = 4) -> np.ndarray:
    """Return one to `most` different numbers below `count`."""
    return rng.choice(count, min(count, int(rng.integers(1, most + 1))), replace=False)


def cut_faces(vertices, faces, rng):
    return vertices, np.delete(faces, _some(rng, len(faces), 12), axis=0)


def cut_vertex(vertices, faces, rng):
    return vertices, faces[(faces != rng.integers(len(vertices))).all(axis=1)]


def cut_through(vertices, faces, rng):
    """Cut along a plane, which may give two components."""
    with np.errstate(all="ignore"):
        heights = vertices[faces] @ rng.normal(size=3)
        level = np.median(heights)
        return vertices, faces[((heights < level).all(axis=1)) | ((heights >= level).all(axis=1))]


def duplicate_faces(vertices, faces, rng):
    return vertices, np.concatenate([faces, np.roll(faces[_some(rng, len(faces))], rng.integers(3), axis=1)])


def duplicate_reversed(vertices, faces, rng):
    return vertices, np.concatenate([faces, faces[_some(rng, len(faces))][:, ::-1]])


def flip_faces(vertices, faces, rng):
    flipped = faces.copy()
    which = rng.random(len(faces)) < rng.random()
    flipped[which] = flipped[which][:, ::-1]
    return vertices, flipped


def merge_neighbours(vertices, faces, rng):
    """Merge two neighbouring vertices: some faces then repeat a vertex."""
    a, b, _ = rng.permuted(faces[rng.integers(len(faces))])
    return vertices, np.where(faces == a, b, faces)


def merge_far(vertices, faces, rng):
    """Merge two random vertices: several fans then meet at one vertex, and some faces are stretched."""
    a, b = rng.integers(len(vertices), size=2)
    return vertices, np.where(faces == a, b, faces)


def corner_far(vertices, faces, rng):
    """Replace a corner of some faces by a random vertex."""
    moved = faces.copy()
    moved[_some(rng, len(faces)), rng.integers(3)] = rng.integers(len(vertices))
    return vertices, moved


def coincide(vertices, faces, rng):
    moved = vertices.copy()
    if rng.random() < 0.5:  # two neighbours coincide, so that their edge has length zero
        a, b, _ = rng.permuted(faces[rng.integers(len(faces))])
        moved[a] = moved[b]
    else:
        moved[_some(rng, len(vertices))] = vertices[rng.integers(len(vertices))]
    return moved, faces


def split_vertex(vertices, faces, rng):
    """Give half of a vertex's faces a copy of the vertex."""
    vertex = faces[rng.integers(len(faces)), 0]
    split = faces.copy()
    own = (faces == vertex) & (rng.random((len(faces), 1)) < 0.5)
    split[own] = len(vertices)
    return np.concatenate([vertices, vertices[[vertex]]]), split


def noise(vertices, faces, rng):
    with np.errstate(all="ignore"):
        size = np.nanstd(np.where(np.isfinite(vertices), vertices, np.nan)) * 10.0 ** rng.uniform(-8, 0.3)
        return vertices + rng.normal(size=vertices.shape) * (size if np.isfinite(size) else 1.0), faces


def spikes(vertices, faces, rng):
    moved = vertices.copy()
    with np.errstate(all="ignore"):
        moved[_some(rng, len(vertices))] *= 10.0 ** rng.uniform(-3, 3)
    return moved, faces


def far_spike(vertices, faces, rng):
    """Move a vertex so far away that its edges are much longer than all others."""
    moved = vertices.copy()
    with np.errstate(all="ignore"):
        moved[rng.integers(len(vertices))] *= 10.0 ** rng.uniform(3, 40)
    return moved, faces


def not_finite(vertices, faces, rng):
    moved = vertices.copy()
    moved[_some(rng, len(vertices)), rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
    return moved, faces


def flatten_face(vertices, faces, rng):
    """Move a corner onto the line through the other two, which gives a face of zero area."""
    moved = vertices.copy()
    a, b, c = rng.permuted(faces[rng.integers(len(faces))])
    share = rng.choice([0.5, rng.uniform(-0.5, 1.5)])
    with np.errstate(all="ignore"):
        moved[c] = (1 - share) * vertices[a] + share * vertices[b]
    return moved, faces


def collinear_faces(vertices, faces, rng):
    """Add a face of three collinear vertices: the ends of an edge and its midpoint."""
    a, b, _ = rng.permuted(faces[rng.integers(len(faces))])
    with np.errstate(all="ignore"):
        middle = 0.5 * vertices[[a]] + 0.5 * vertices[[b]]
    return np.concatenate([vertices, middle]), np.concatenate([faces, [[a, len(vertices), b]]])


def fin(vertices, faces, rng):
    """Add a third face at an edge, with a new vertex or a random one."""
    a, b, _ = rng.permuted(faces[rng.integers(len(faces))])
    if rng.random() < 0.5:
        return vertices, np.concatenate([faces, [[a, b, rng.integers(len(vertices))]]])
    with np.errstate(all="ignore"):
        tip = vertices[[a]] * rng.uniform(0.5, 2) + rng.normal(0, 0.2, (1, 3))
    return np.concatenate([vertices, tip]), np.concatenate([faces, [[a, b, len(vertices)]]])


def isolated(vertices, faces, rng):
    """Insert unused vertices at the start, which shifts all other indices."""
    extra = rng.normal(size=(int(rng.integers(1, 4)), 3)) * rng.choice([1.0, 1e9, np.nan])
    return np.concatenate([extra, vertices]), faces + len(extra)


def second_component(vertices, faces, rng):
    with np.errstate(all="ignore"):
        other = vertices * 10.0 ** rng.uniform(-2, 1) + rng.normal(0, 2, 3)
    return np.concatenate([vertices, other]), np.concatenate([faces, faces + len(vertices)])


def rescale(vertices, faces, rng):
    with np.errstate(all="ignore"):
        return vertices * 10.0 ** rng.uniform(-30, 30), faces


def huge(vertices, faces, rng):
    """Scale so that squared lengths leave the range of double precision."""
    with np.errstate(all="ignore"):
        return vertices * 10.0 ** (rng.choice([-1, 1]) * rng.uniform(100, 308)), faces


def squash(vertices, faces, rng):
    """Scale one axis only, so that all triangles become needles."""
    with np.errstate(all="ignore"):
        return vertices * np.where(np.arange(3) == rng.integers(3), 10.0 ** rng.uniform(-6, 2), 1.0), faces


def out_of_range(vertices, faces, rng):
    wrong = faces.copy()
    wrong[rng.integers(len(faces)), rng.integers(3)] = rng.choice([-1, len(vertices), 2**31 - 1, -(2**31)])
    return vertices, wrong


DEFECTS: Final[dict[str, Defect]] = {
    defect.__name__: defect
    for defect in (
        cut_faces, cut_vertex, cut_through, duplicate_faces, duplicate_reversed, flip_faces, merge_neighbours,
        merge_far, corner_far, coincide, split_vertex, noise, spikes, far_spike, not_finite, flatten_face,
        collinear_faces, fin, isolated, second_component, rescale, huge, squash, out_of_range,
    )
}  # fmt: skip

COARSE: Final = frozenset({"far_spike", "squash"})
"""Defects with large errors, because of single precision and bounded unfolding: needles and extreme lengths."""

SELDOM: Final = frozenset({"huge", "out_of_range"})
"""Defects that mostly cause an error, which would hide the effects of other defects."""


def spoil(base: str, steps: list[tuple[str, int]]) -> Mesh:
    """Apply defects, each with its own seed, to one of `BASES`."""
    surface = BASES[base]()
    vertices, faces = np.array(surface.vertices), np.array(surface.faces, np.int64)
    for name, seed in steps:
        if len(faces) and faces.min() >= 0 and faces.max() < len(vertices):
            vertices, faces = DEFECTS[name](vertices, faces, np.random.default_rng(seed))
    return Mesh(vertices, faces.reshape(-1, 3), (base, *(f"{name}:{seed}" for name, seed in steps)))


def defective(names: frozenset[str] = frozenset(DEFECTS)) -> st.SearchStrategy[Mesh]:
    """Return a strategy for meshes with one to four defects; Hypothesis shrinks to fewer and earlier defects."""
    step = st.tuples(st.sampled_from([name for name in DEFECTS if name in names]), st.integers(0, 2**32 - 1))
    return st.builds(spoil, st.sampled_from(list(BASES)), st.lists(step, min_size=1, max_size=4))


def random_defective(rng: np.random.Generator) -> Mesh:
    """Return a random mesh like those of `defective`, for runs too long for Hypothesis."""
    names = list(DEFECTS)
    weights = np.array([0.25 if name in SELDOM else 1.0 for name in names])
    chosen = rng.choice(names, int(rng.integers(1, 5)), p=weights / weights.sum())
    return spoil(str(rng.choice(list(BASES))), [(str(name), int(rng.integers(2**32))) for name in chosen])


@dataclass(frozen=True)
class Outcome:
    """The repaired surface or the error, and the relative errors of distances by update."""

    error: MeshError | None = None
    surface: Surface | None = None
    sources: tuple[int, ...] = ()
    relative: dict[str, np.ndarray] | None = None


def examine(
    mesh: Mesh, rng: np.random.Generator, components: str = "largest", sources: int = 2, seams: str = "stitch"
) -> Outcome:
    """Repair a mesh and compare its distances with exact ones; raise AssertionError if a check fails."""
    given = mesh.vertices.copy(), mesh.faces.copy()
    try:
        surface = repair(mesh.vertices, mesh.faces, policy=MeshPolicy(components=components, seams=seams))
    except MeshError as error:
        return Outcome(error)
    finally:
        np.testing.assert_array_equal(mesh.vertices, given[0], "repair changed the vertices given to it")
        np.testing.assert_array_equal(mesh.faces, given[1], "repair changed the faces given to it")
    check_places(surface, mesh.vertices)
    used = surface.used_vertices
    chosen = rng.choice(used, min(sources, len(used)), replace=False)
    try:
        return Outcome(None, surface, tuple(chosen.tolist()), check_distances(surface, chosen))
    except MeshError as error:  # edges too long for single precision
        return Outcome(error)


def check_places(surface: Surface, vertices: np.ndarray) -> None:
    """Check that every vertex of the mesh is on the surface, in order, and at its position."""
    where = np.arange(len(vertices)) if surface.vertex_map is None else surface.vertex_map
    lowest, first = np.unique(where, return_index=True)
    assert len(where) == len(vertices), "the vertex map has another length"
    assert (lowest == np.arange(len(surface.vertices))).all(), "some vertices of the surface are not in the map"
    assert (np.diff(first) > 0).all(), "the order of vertices changed"
    on_faces = np.isin(where, surface.used_vertices)
    apart = np.abs(surface.vertices[where[on_faces]] - vertices[on_faces]).max()
    assert apart <= (surface.report.seam_tolerance or 0.0), "vertices moved"


def check_distances(surface: Surface, sources: np.ndarray) -> dict[str, np.ndarray]:
    """Check the distances of each update; return (d - exact) / exact of all pairs with both finite, by update."""
    try:
        exact = soup_distances(surface, sources)
    except TooManyWindowsError:
        exact = steiner_distances(surface, sources)  # up to about two percent too long
    longest = edge_path_distances(surface, sources)
    return {update: check_rows(surface, sources, update, longest, exact) for update in UPDATES}


def check_rows(surface, sources, update, longest, exact=None) -> np.ndarray:
    """Check the distances of one update; return their errors relative to `exact`, or an empty array without it."""
    distances = geodesic_distances(surface, sources, update=update)
    assert distances.shape == (len(sources), len(surface.vertices))
    assert not np.isnan(distances).any(), f"{update}: NaN"
    assert (distances[np.arange(len(sources)), sources] == 0).all(), f"{update}: not zero at the source"
    reached = np.isfinite(distances)
    assert (reached == np.isfinite(longest)).all(), (
        f"{update}: reached {reached.sum()}, not {np.isfinite(longest).sum()}"
    )
    straight = np.linalg.norm(surface.vertices[sources][:, None] - surface.vertices, axis=2)
    assert (distances[reached] >= straight[reached] * (1 - SHORTFALL)).all(), (
        f"{update}: shorter than straight by {_worst(straight[reached], distances[reached])}"
    )
    nothing = NOTHING * stencils_of(surface).unit
    assert (distances[reached] <= longest[reached] * (1 + DETOUR) + nothing).all(), (
        f"{update}: longer than along edges by {_worst(distances[reached], longest[reached])}"
    )
    if exact is None:
        return np.empty(0)
    apart = reached & (exact > nothing)
    return distances[apart] / exact[apart] - 1


def _worst(larger: np.ndarray, smaller: np.ndarray) -> str:
    with np.errstate(all="ignore"):
        return f"{np.nanmax(larger / smaller) - 1:.3g}"
