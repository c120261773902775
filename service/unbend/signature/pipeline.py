"""`compute_signature`: sample, march, embed, pose, describe."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Final

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
from unbend.embedding.weighting import weights_for
from unbend.errors import MeshGeometryError
from unbend.geodesics.distances import sampled_matrix
from unbend.geodesics.sampling import sample_farthest
from unbend.geodesics.stencils import stencils_of
from unbend.geodesics.voronoi import cell_areas
from unbend.local.signatures import local_signatures
from unbend.mesh.read import surface_of
from unbend.mesh.smooth import relative_boundary
from unbend.mesh.sources import MeshSource
from unbend.mesh.surface import Surface
from unbend.progress import Progress, ProgressCallback, ignore
from unbend.signature.connectivity import signature_faces
from unbend.signature.parameters import MAX_SAMPLES, Parameters, ParametersLike
from unbend.signature.signature import Signature
from unbend.threads import one_blas_thread
from unbend.tolerances import DOUBTFUL_ASYMMETRY

# Share of the total progress at which each stage begins. Distance rows take most of the time.
_SAMPLING, _GEODESICS, _EMBEDDING, _DESCRIBING = 0.02, 0.1, 0.85, 0.98
_FEWEST_SAMPLES: Final = 64
_MANY_ITERATIONS = 100  # after this many iterations, progress shows half of the embedding as done


def compute_signature(
    surface: MeshSource,
    parameters: ParametersLike = None,
    *,
    progress: ProgressCallback | None = None,
    threads: int | None = None,
    local: bool = False,
) -> Signature:
    """Compute the bending-invariant signature of `surface` (Elad & Kimmel 2003, section 2).

    Parameters
    ----------
    surface : Surface, or anything that `read_mesh` takes
        The faces of a `Surface` must be connected. Other meshes are read by `read_mesh` with the default policy.
    parameters : Parameters or mapping, optional
        `Parameters()` by default.
    progress : callable, optional
        Called with a `Progress` from time to time.
    threads : int, optional
        Threads for distance rows and embedding; all cores by default. The result does not depend on it.
    local : bool, default False
        Compute local signatures, too, by which pieces are recognised. It takes about as long as the signature.

    Returns
    -------
    Signature
        The same for the same input on every run.

    Raises
    ------
    MeshGeometryError
        If the surface has no area, or its faces are not connected; other errors as by `read_mesh`.
    ParameterError
        If `threads` is below 1.

    Examples
    --------
    >>> from unbend.mesh.shapes import sphere
    >>> signature = compute_signature(sphere(), Parameters(samples=50))
    >>> signature.points.shape
    (50, 3)
    >>> sorted(signature.descriptors)
    ['dimension', 'distribution', 'moments', 'reeb', 'spectrum', 'surface_moments']
    """
    chosen = Parameters.of(parameters)
    report = progress or ignore
    surface = surface_of(surface, progress=progress)
    if not surface.area > 0:
        raise MeshGeometryError("every face has zero area")
    if local:
        return _with_local(surface, chosen, report, threads)
    if chosen.samples == AUTO:
        return _by_doubling(surface, chosen, report, threads)
    return _computed(surface, chosen, min(int(chosen.samples), len(surface.used_vertices)), report, threads)


def _with_local(surface: Surface, chosen: Parameters, report: ProgressCallback, threads: int | None) -> Signature:
    """Compute the signature, then the local signatures, which take about as long."""
    found = compute_signature(
        surface, chosen, progress=lambda made: report(replace(made, share=made.share / 2)), threads=threads
    )
    circles = local_signatures(
        surface, threads=threads, progress=lambda share: report(Progress("describing", (1.0 + share) / 2))
    )
    return replace(found, local=circles)


def _by_doubling(surface: Surface, chosen: Parameters, report: ProgressCallback, threads: int | None) -> Signature:
    """Double the number of samples until the spectrum converges, or all vertices are samples."""
    most = min(MAX_SAMPLES, len(surface.used_vertices))
    count, begin = min(_FEWEST_SAMPLES, most), 0.0

    def report_half(progress: Progress, begin: float = 0.0) -> None:
        # The number of rounds is unknown, so each round takes half of the remaining progress.
        report(replace(progress, share=begin + progress.share * (1.0 - begin) / 2))

    found = _computed(surface, chosen, count, report_half, threads)
    change = np.inf
    while change > chosen.tolerance and count < most:
        count, begin, before = min(2 * count, most), (1.0 + begin) / 2, found.spectrum
        found = _computed(surface, chosen, count, partial(report_half, begin=begin), threads)
        change = np.abs(found.spectrum - before).sum() / np.abs(found.spectrum).sum()
    return found


def _computed(
    surface: Surface, chosen: Parameters, count: int, report: ProgressCallback, threads: int | None
) -> Signature:
    """Compute the signature with `count` samples."""
    with one_blas_thread(count):
        return _steps(surface, chosen, count, report, threads)


def _steps(
    surface: Surface, chosen: Parameters, count: int, report: ProgressCallback, threads: int | None
) -> Signature:
    def report_samples(made: int) -> None:
        share = _SAMPLING + made / count * (_GEODESICS - _SAMPLING)
        report(Progress("sampling", share, {"sample": made, "samples": count}))

    def report_rows(share: float) -> None:
        detail = {"row": round(share * count), "rows": count}
        report(Progress("geodesics", _GEODESICS + share * (_EMBEDDING - _GEODESICS), detail))

    most_made = 0

    def report_iteration(made: int, stress: float) -> None:
        nonlocal most_made
        most_made = max(most_made, made)  # the count restarts for each number of dimensions
        share = _EMBEDDING + most_made / (most_made + _MANY_ITERATIONS) * (_DESCRIBING - _EMBEDDING)
        report(Progress("embedding", share, {"iteration": made, "stress": stress}))

    report_samples(0)
    stencils = stencils_of(surface)
    sampling = sample_farthest(surface, stencils, count, start=_first_sample(surface, chosen), progress=report_samples)
    weights = cell_areas(surface, sampling.nearest, count)

    report_rows(0.0)
    samples = sampling.samples.astype(np.int32)
    matrix = sampled_matrix(stencils, samples, chosen.update, threads, report_rows)
    if not np.isfinite(matrix.distances).all():
        raise MeshGeometryError("the faces are not connected: keep one component")

    report(Progress("embedding", _EMBEDDING))
    embedding = embed(
        matrix.distances, chosen.dimensions, method=chosen.method,
        weights=weights_for(chosen.weights, matrix.distances, weights), starts=chosen.starts, seed=chosen.seed,
        criterion=chosen.criterion, threshold=chosen.threshold, threads=threads, progress=report_iteration,
    )  # fmt: skip

    report(Progress("describing", _DESCRIBING))
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
        boundary=relative_boundary(surface),
    )


def _first_sample(surface: Surface, chosen: Parameters) -> int | None:
    if chosen.first_sample == "end":
        return None
    return int(np.random.default_rng(chosen.seed).choice(surface.used_vertices))


def _doubts(asymmetry: float) -> tuple[str, ...]:
    """Return a warning if distances are too asymmetric, because correct distances are equal in both directions."""
    sentence = (
        f"distances may be wrong: some differ by {asymmetry:.0%} of the largest from those in the opposite direction; "
        "thin triangles and vertices where separate parts touch cause this: remesh the surface, or simplify it with "
        "`max_vertices`"
    )
    return (sentence,) if asymmetry > DOUBTFUL_ASYMMETRY else ()


def _scale(posed: Floats, area: float, parameters: Parameters) -> float:
    if parameters.scaling == "area":
        return float(np.sqrt(area))
    return float(np.ptp(posed, axis=0).max())


def _describe(surface: Surface, posed: Floats, faces: Ints, distances: Floats, weights: Floats) -> dict[str, Floats]:
    # Descriptors always refer to area 1, whatever the scaling of the points.
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
