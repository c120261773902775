"""The one way from a surface to its signature: sample, march, embed, pose, describe."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final, Self

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.descriptors.dimension import dimension_vector
from unbend.descriptors.distribution import distance_distribution
from unbend.descriptors.moments import moments
from unbend.descriptors.pose import principal_pose
from unbend.descriptors.quadrature import surface_quadrature
from unbend.descriptors.reeb import reeb_graph
from unbend.descriptors.spectrum import geodesic_spectrum
from unbend.embedding.embed import AUTO, embed
from unbend.embedding.weighting import weights_of
from unbend.errors import MeshGeometryError
from unbend.geodesics.distances import sampled_matrix
from unbend.geodesics.sampling import sample_farthest
from unbend.geodesics.stencils import stencils_of
from unbend.mesh.surface import Surface
from unbend.signature.connectivity import signature_faces
from unbend.signature.parameters import MAX_SAMPLES, Parameters
from unbend.signature.signature import Signature
from unbend.tolerances import DOUBTFUL_ASYMMETRY

Progress = Callable[[str, float], None]
"""Called with a stage's name, a `Stage`, and the share of the whole that is done, 0 to 1."""

# Where each stage begins, as a share of the whole. The distance rows are nearly all of the work.
_SAMPLING, _GEODESICS, _EMBEDDING, _DESCRIBING = 0.02, 0.1, 0.85, 0.98
_FEWEST_SAMPLES: Final = 64
_MANY_ITERATIONS = 100  # after so many, half of the embedding's share is shown as done


class Stage(str):
    """A stage's name, and what it can tell of itself: `sample` of `samples`, or `iteration` and `stress`."""

    __slots__ = ("detail",)
    detail: dict[str, float]

    def __new__(cls, name: str, **detail: float) -> Self:
        """Make it equal to its name."""
        stage = super().__new__(cls, name)
        stage.detail = detail
        return stage


def compute_signature(
    surface: Surface,
    parameters: Parameters | None = None,
    *,
    progress: Progress | None = None,
    threads: int | None = None,
) -> Signature:
    """Compute the bending-invariant signature of `surface` (Elad & Kimmel 2003, section 2).

    Parameters
    ----------
    surface : Surface
        Its faces must hang together; `read_mesh` sees to that.
    parameters : Parameters, optional
        Defaults as `Parameters()` has them.
    progress : callable, optional
        Called as progress(stage, share) while the work goes on; `stage.detail` tells more.
    threads : int, optional
        For distance rows and embedding; all cores by default. The result does not depend on it.

    Returns
    -------
    Signature
        The same for the same input, on every run.

    Raises
    ------
    MeshGeometryError
        If the surface has no area, or its faces do not hang together.
    ParameterError
        If `threads` is below 1.
    """
    chosen = parameters or Parameters()
    report = progress or (lambda _stage, _share: None)
    if not surface.area > 0:
        raise MeshGeometryError("every face has zero area")
    if chosen.samples == AUTO:
        return _by_doubling(surface, chosen, report, threads)
    return _computed(surface, chosen, min(int(chosen.samples), len(surface.used_vertices)), report, threads)


def _by_doubling(surface: Surface, chosen: Parameters, report: Progress, threads: int | None) -> Signature:
    """Double the samples until the spectrum hardly moves, or there are no more vertices."""
    most = min(MAX_SAMPLES, len(surface.used_vertices))
    count, begin = min(_FEWEST_SAMPLES, most), 0.0

    def report_half(stage: str, share: float, begin: float = 0.0) -> None:
        report(stage, begin + share * (1.0 - begin) / 2)  # nobody knows how many rounds are left

    found = _computed(surface, chosen, count, report_half, threads)
    moves = np.inf
    while moves > chosen.tolerance and count < most:
        count, begin, before = min(2 * count, most), (1.0 + begin) / 2, found.spectrum
        found = _computed(surface, chosen, count, partial(report_half, begin=begin), threads)
        moves = np.abs(found.spectrum - before).sum() / np.abs(found.spectrum).sum()
    return found


def _computed(surface: Surface, chosen: Parameters, count: int, report: Progress, threads: int | None) -> Signature:
    """Compute the signature with `count` samples."""

    def report_samples(made: int) -> None:
        share = _SAMPLING + made / count * (_GEODESICS - _SAMPLING)
        report(Stage("sampling", sample=made, samples=count), share)

    def report_rows(share: float) -> None:
        stage = Stage("geodesics", row=round(share * count), rows=count)
        report(stage, _GEODESICS + share * (_EMBEDDING - _GEODESICS))

    most_made = 0

    def report_iteration(made: int, stress: float) -> None:
        nonlocal most_made
        most_made = max(most_made, made)  # in another number of dimensions they are counted anew
        share = _EMBEDDING + most_made / (most_made + _MANY_ITERATIONS) * (_DESCRIBING - _EMBEDDING)
        report(Stage("embedding", iteration=made, stress=stress), share)

    report_samples(0)
    stencils = stencils_of(surface)
    sampling = sample_farthest(surface, stencils, count, start=_first_sample(surface, chosen), progress=report_samples)
    weights = _cell_areas(surface.vertex_areas, sampling.nearest, count)

    report_rows(0.0)
    samples = sampling.samples.astype(np.int32)
    matrix = sampled_matrix(stencils, samples, chosen.update, threads, report_rows)
    if not np.isfinite(matrix.distances).all():
        raise MeshGeometryError("the faces do not hang together: keep one component")

    report(Stage("embedding"), _EMBEDDING)
    embedding = embed(
        matrix.distances, chosen.dimensions, method=chosen.method,
        weights=weights_of(chosen.weights, matrix.distances, weights), starts=chosen.starts, seed=chosen.seed,
        criterion=chosen.criterion, threshold=chosen.threshold, threads=threads, progress=report_iteration,
    )  # fmt: skip

    report(Stage("describing"), _DESCRIBING)
    posed = principal_pose(embedding.points, weights)
    faces = signature_faces(surface, sampling.samples, sampling.nearest, matrix.distances)
    scale = _scale(posed, surface.area, chosen)
    return Signature(
        points=posed / scale,
        faces=faces,
        samples=sampling.samples,
        weights=weights / weights.sum(),
        scale=scale,
        stress=embedding.stress,
        asymmetry=matrix.asymmetry,
        descriptors=_describe(surface, posed, faces, matrix.distances, weights / weights.sum()),
        parameters=chosen,
        warnings=(*surface.report.warnings, *_doubts(matrix.asymmetry)),
    )


def _first_sample(surface: Surface, chosen: Parameters) -> int | None:
    if chosen.first_sample == "end":
        return None
    return int(np.random.default_rng(chosen.seed).choice(surface.used_vertices))


def _doubts(asymmetry: float) -> tuple[str, ...]:
    """Return a warning where distances contradict each other: right distances are equal in both directions."""
    sentence = (
        f"distances may be wrong: measured from both ends, some differ by {asymmetry:.0%} of the largest; needles and "
        "vertices where separate parts touch do that: remesh the surface, or simplify it with `max_vertices`"
    )
    return (sentence,) if asymmetry > DOUBTFUL_ASYMMETRY else ()


def _cell_areas(vertex_areas: Floats, nearest: Ints, count: int) -> Floats:
    reached = nearest >= 0
    return np.bincount(nearest[reached], vertex_areas[reached], minlength=count).astype(np.float64)


def _scale(posed: Floats, area: float, parameters: Parameters) -> float:
    if parameters.scaling == "area":
        return float(np.sqrt(area))
    return float(np.ptp(posed, axis=0).max())


def _describe(surface: Surface, posed: Floats, faces: Ints, distances: Floats, weights: Floats) -> dict[str, Floats]:
    # always for area 1, whatever the points are scaled to
    points, unit = posed / np.sqrt(surface.area), distances / np.sqrt(surface.area)
    return {
        "spectrum": geodesic_spectrum(unit, weights),
        "moments": moments(*surface_quadrature(points, faces, weights)),
        "distribution": distance_distribution(unit, points, weights),
        "dimension": dimension_vector(distances),
        "reeb": reeb_graph(distances, faces, weights).pack(),
        "surface_moments": _surface_moments(surface),
    }


def _surface_moments(surface: Surface) -> Floats:
    places, masses = surface_quadrature(surface.vertices / np.sqrt(surface.area), surface.faces, surface.vertex_areas)
    return moments(places, masses)
