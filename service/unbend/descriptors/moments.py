"""Second and third order moments of a point set (Tal & Elad, cited in section 2.3), without a choice of axes.

For the points of `surface_quadrature`, these are the moments of a surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.descriptors.pose import in_principal_axes

_AXES: Final = 3
BLUR: Final = 0.05
"""Axes are blended if their second moments differ by less than about this share of the sum of second moments."""

MIXED: Final = ((0, 0, 0), (0, 1, 1), (0, 1, 2), (0, 2, 2), (1, 1, 1), (1, 1, 2), (1, 2, 2), (2, 2, 2))
"""Third moments that are kept. The paper uses fewer than 15 numbers, so the two most redundant moments are left out.

These are (0, 0, 1) and (0, 0, 2). The sums along axes 1 and 2 contain most of them, because most of the spread is along
axis 0.
"""


def moments(
    points: Floats, weights: Floats, *, blur: float = BLUR, mixed: Sequence[tuple[int, int, int]] = MIXED
) -> Floats:
    """Return the moments of a point set about its principal axes, as a continuous function of the points.

    If two second moments are nearly equal, the axes in their plane are arbitrary, and moments along these axes jump
    with the rounding of the input. So each axis a is blurred: the projection onto it is replaced by a function of the
    second moment matrix M, f_a(M) = k(M - l_a) / tr k(M - l_a), where l_a is an eigenvalue of M and k a Gaussian whose
    width is a share of tr M. For axes with well separated moments, f_a(M) is the projection. Axes with equal moments
    all get the mean of their projections. With the third moments T, the mean of x (x) x (x) x, and their sums
    t_i = sum_j T_ijj,

        s_a = sqrt(f_a(M) : t (x) t)        m_abc = sqrt(T : (f_a(M) (x) f_b(M) (x) f_c(M)) : T).

    For well separated axes these are |t_a| and |T_abc| in the principal frame. They are norms, so they change by at
    most a multiple of the change of the points, and they are equal for mirrored sets. Absolute values alone lose the
    signs of T_aaa, T_abb and T_acc relative to each other, but s_a depends on these signs.

    Parameters
    ----------
    points : (n, m) float64
        The points, in any pose.
    weights : (n,) float64
        Area that each point represents.
    blur : float
        Width of the Gaussian, as a share of the second moments' sum.
    mixed : sequence of (a, b, c)
        Axes of the m_abc to return, in ascending order.

    Returns
    -------
    (6 + number of `mixed`,) float64
        The three largest second moments l_a, three s_a, then the m_abc. The s_a and m_abc are divided by the root mean
        square distance of the points from their centre, so that all values are squares of a length. If m < 3, missing
        axes count as zero. If m > 3, sums and blur include all axes.
    """
    spread, second, third = _principal(points, weights)
    blurred = np.exp(-(((second[:_AXES, None] - second) / blur) ** 2))  # (3, m)
    blurred /= blurred.sum(axis=1, keepdims=True)
    sums = blurred @ np.einsum("ijj->i", third) ** 2
    squares = third**2
    for _ in range(3):  # contracts the first axis and appends the blurred axis
        squares = np.tensordot(squares, blurred, (0, 1))
    kept = np.array([squares[axes] for axes in mixed])
    return np.asarray(spread * np.concatenate([second[:_AXES], np.sqrt(np.concatenate([sums, kept]))]))


def _principal(points: Floats, weights: Floats) -> tuple[float, Floats, Floats]:
    """Return the mean squared distance from the centre, and the second and third moments in the principal axes.

    The moments are those of the points divided by the root of that mean. The second moments, falling, are (m,), the
    third moments (m, m, m), with m at least 3.
    """
    share = weights / weights.sum()
    centred = points - share @ points
    spread = float(share @ (centred**2).sum(axis=1))
    if spread > 0:
        centred = centred / np.sqrt(spread)
    centred = np.pad(centred, ((0, 0), (0, max(0, _AXES - points.shape[1]))))
    turned = in_principal_axes(centred, share)
    pairs = turned[:, :, None] * (turned * share[:, None])[:, None, :]
    third = np.tensordot(pairs, turned, (0, 0))
    return spread, np.einsum("nii->i", pairs), third
