"""`transfer`: values of one surface carried to another by a correspondence."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.arrays import Indices
from unbend.correspondence.correspondence import Correspondence
from unbend.errors import ParameterError


def transfer(correspondence: Correspondence, values: ArrayLike) -> NDArray[Any]:
    """Carry values at the vertices of `b` to the vertices of `a`.

    Parameters
    ----------
    correspondence : Correspondence
        From `match(a, b)`.
    values : (m,) or (m, k) array
        One row for each vertex of `b`. Floating point numbers are interpolated linearly in the triangles. All others,
        such as integers, booleans and strings, are labels: a vertex takes the label with the largest total weight among
        the corners of its face, the first corner of ties.

    Returns
    -------
    (n,) or (n, k) array
        One row for each vertex of `a`, float64 or the type of the labels. At vertices without a point: NaN, or the
        type's zero, False or empty string.

    Raises
    ------
    ParameterError
        If the number of rows is not that of the vertices of `b`.

    Examples
    --------
    >>> from unbend.correspondence.match import match
    >>> from unbend.mesh.shapes import ellipsoid
    >>> body = ellipsoid((1.0, 0.7, 0.4))
    >>> found = match(body, body, samples=100)
    >>> carried = transfer(found, body.vertices)
    >>> bool(abs(carried - body.vertices).max() < 0.2)
    True
    """
    given = np.asarray(values)
    if given.ndim not in {1, 2} or len(given) != correspondence.target_vertices:
        raise ParameterError(
            f"values must have one row for each of the {correspondence.target_vertices} vertices, not {given.shape}"
        )
    corners = correspondence.target_faces[correspondence.faces]
    if given.dtype.kind == "f":
        carried = np.einsum("nc,nc...->n...", correspondence.barycentric, given[corners].astype(np.float64))
        return np.asarray(carried)
    chosen = _heaviest(given.reshape(len(given), -1)[corners], correspondence.barycentric)
    chosen[~correspondence.matched] = np.zeros(1, given.dtype)
    return chosen.reshape(len(corners), *given.shape[1:])


def transfer_landmarks(correspondence: Correspondence, landmarks: ArrayLike) -> Indices:
    """Return the vertex of `a` that is each of the `landmarks`, which are vertices of `b`, (k,) int64.

    It is the vertex whose point is nearest to the landmark: first among the points on faces around the landmark, by the
    weight of that corner. If there is none, the search widens, ring by ring.

    Raises
    ------
    ParameterError
        If a landmark is not a vertex of `b`, or no vertex of `a` has a point in its component.
    """
    wanted = np.atleast_1d(np.asarray(landmarks))
    if wanted.ndim != 1 or not np.issubdtype(wanted.dtype, np.integer):
        raise ParameterError("landmarks must be vertex indices")
    count = correspondence.target_vertices
    bad = wanted[(wanted < 0) | (wanted >= count)]
    if bad.size:
        raise ParameterError(f"landmarks: the mesh has no vertex {bad[0]}, only 0 to {count - 1}")
    return np.array([_vertex_at(correspondence, int(landmark)) for landmark in wanted], np.int64)


def _vertex_at(correspondence: Correspondence, landmark: int) -> int:
    faces = correspondence.target_faces
    weights = np.zeros(correspondence.target_vertices)
    weights[landmark] = 1.0
    while True:
        shares = (np.nan_to_num(correspondence.barycentric) * weights[faces[correspondence.faces]]).sum(axis=1)
        shares[~correspondence.matched] = 0.0
        if shares.any():
            return int(shares.argmax())
        ring = np.unique(faces[(weights[faces] > 0).any(axis=1)])
        if not (weights[ring] == 0).any():
            raise ParameterError(f"landmarks: no vertex has a point near vertex {landmark}")
        weights[ring] = np.maximum(weights[ring], weights[weights > 0].min() / 2)


def _heaviest(labels: NDArray[Any], weights: NDArray[np.float64]) -> NDArray[Any]:
    """Return for each row of labels (n, 3, k) the label of the largest total weight, (n, k)."""
    votes = [
        sum(np.where(labels[:, other] == labels[:, corner], weights[:, other, None], 0.0) for other in range(3))
        for corner in range(3)
    ]
    best = np.argmax(np.nan_to_num(np.stack(votes, axis=1)), axis=1)
    return np.asarray(np.take_along_axis(labels, best[:, None], axis=1)[:, 0])
