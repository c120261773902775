"""Orientation of a canonical form: the one in which it lies best on its surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from unbend.arrays import Floats
from unbend.errors import ParameterError


def orient_form(form_points: ArrayLike, surface_points: ArrayLike, weights: ArrayLike | None = None) -> Floats:
    """Turn a canonical form as its surface stands, so that it is upright where the surface is.

    A form is known up to a rotation and a reflection. This function rotates and reflects the first three coordinates
    around the origin so that the sum of squared distances between the points of form and surface, both centred, is
    least (Kabsch 1976; the reflection is allowed). Further coordinates, distances and the scale stay.

    Parameters
    ----------
    form_points : (n, m) float
        Canonical coordinates, three or more. Rows that are not finite are ignored, and are not finite in the result.
    surface_points : (n, 3) float
        The same vertices on the surface, in any unit.
    weights : (n,) float, optional
        How much each vertex counts, such as the area around it; all equally by default.

    Returns
    -------
    (n, m) float64

    Raises
    ------
    ParameterError
        If the shapes do not fit, a weight is negative or not a number, or no row is finite.

    Examples
    --------
    >>> from unbend.mesh.shapes import ellipsoid
    >>> points = ellipsoid().vertices
    >>> turned = orient_form(points[:, [2, 0, 1]], points)
    >>> bool(abs(turned - points).max() < 1e-9)
    True
    """
    form, surface = np.asarray(form_points, np.float64), np.asarray(surface_points, np.float64)
    if form.ndim != 2 or form.shape[1] < 3:
        raise ParameterError(f"form_points must be (n, 3) or have more columns, not {form.shape}")
    if surface.shape != (len(form), 3):
        raise ParameterError(f"surface_points must be ({len(form)}, 3), one for each point, not {surface.shape}")
    share = np.ones(len(form)) if weights is None else np.array(weights, np.float64)
    if share.shape != (len(form),) or not (share >= 0).all():
        raise ParameterError(f"weights must be ({len(form)},) numbers, none negative")
    known = np.isfinite(form).all(axis=1) & np.isfinite(surface).all(axis=1)
    if not known.any():
        raise ParameterError("form_points: no point is finite")
    turned = form.copy()
    turned[:, :3] = form[:, :3] @ _rotation(form[known, :3], surface[known], share[known])
    return turned


def _rotation(points: Floats, target: Floats, share: Floats) -> Floats:
    """Return the orthogonal matrix that `points` are multiplied by to lie on `target`."""
    whole = share.sum()
    share = share / whole if whole > 0 else np.full(len(share), 1 / len(share))
    apart, onto = points - share @ points, target - share @ target
    left, _, right = np.linalg.svd((apart * share[:, None]).T @ onto)
    return np.asarray(left @ right)
