"""The stress of eq. 7 and its gradient, without temporary n x n matrices."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.jit import kernel
from unbend.threads import Team, check_threads

_ROWS: Final = 64  # rows of distances in a block; sums are made per block, so they do not depend on threads
_THREADED: Final = 1500  # fewest points for which threads are used; for fewer, their wake-up takes longer
_NONE: Final = np.empty((0, 0), np.float32)


def team_for(count: int, threads: int | None) -> Team:
    """Return the threads that share the gradients of `count` points: at most `threads`, by default all cores."""
    return Team(check_threads(threads) if count >= _THREADED else 1)


class StressGradient:
    """The function that scaling minimises, eq. 7 over the sum of squared distances, and half of the gradient of eq. 7.

    Parameters
    ----------
    distances : (n, n) float64
    weights : (n, n) float64, optional
        Ones by default.
    single : bool
        Whether to compute in single precision: half the memory, twice the speed. Sums are in double precision.
    team : Team
        Threads that share the work; the result does not depend on their number.
    """

    def __init__(self, distances: Floats, weights: Floats | None, *, single: bool, team: Team) -> None:
        kind = np.float32 if single else np.float64
        count = len(distances)
        self._total = float(np.einsum("ij,ij", distances, distances)) / 2 or 1.0
        self._scale = float(distances.max()) or 1.0  # keeps squares in the range of single precision
        self._distances = np.empty((count, count), kind)
        np.divide(distances, self._scale, out=self._distances, casting="same_kind")  # without a copy in double
        self._weights = _NONE.astype(kind) if weights is None else weights.astype(kind)
        self._team = team
        self._blocks = -(-count // _ROWS)
        self._losses = np.empty((self._blocks, count), kind)

    def __call__(self, axes: Floats) -> tuple[float, Floats]:
        """Return the relative stress (eq. 2) of points given as (m, n), and V X - B(X) X of eq. 8, (m, n).

        The second result is half of the gradient of eq. 7. Its column j is
        sum_i w_ij (1 - delta_ij / d_ij) (x_j - x_i).
        """
        points = (axes / self._scale).astype(self._distances.dtype)
        gradients = np.empty((self._blocks, *points.shape), points.dtype)

        def work(part: slice) -> None:
            add_blocks(points, self._distances, self._weights, part.start, part.stop, gradients, self._losses)

        if self._team.threads == 1:
            work(slice(0, self._blocks))
        else:
            self._team.share_out(self._blocks, work)
        raw = 0.5 * self._losses.sum(dtype=np.float64) * self._scale**2
        return raw / self._total, gradients.sum(axis=0, dtype=np.float64) * self._scale


@kernel
def add_blocks(axes, distances, weights, first, stop, gradients, losses):
    """Fill blocks `first` to `stop` - 1 of the gradient and of the loss, each from `_ROWS` rows of distances.

    The inner loops over j have no reductions, so they are vectorised and still round in a fixed order.
    """
    count = axes.shape[1]
    for block in range(first, stop):
        gradient, loss = gradients[block], losses[block]
        gradient[:] = 0
        loss[:] = 0
        rows = block * _ROWS, min(count, (block + 1) * _ROWS)
        if len(axes) == 3 and len(weights) == 0:  # the usual case, which takes half the time this way
            _add_rows_in_space(axes[0], axes[1], axes[2], distances, rows, gradient[0], gradient[1], gradient[2], loss)
        else:
            _add_rows(axes, distances, weights, rows, gradient, loss)


@kernel
def _add_rows_in_space(x, y, z, distances, rows, along_x, along_y, along_z, loss):
    """Add the contribution of some rows, for three dimensions without weights, so that all values stay in registers."""
    zero = x.dtype.type(0)
    for i in range(rows[0], rows[1]):
        given = distances[i]
        here_x, here_y, here_z = x[i], y[i], z[i]
        for j in range(len(x)):
            dx, dy, dz = x[j] - here_x, y[j] - here_y, z[j] - here_z
            distance = np.sqrt(dx * dx + dy * dy + dz * dz)
            difference = distance - given[j]
            loss[j] += difference * difference
            factor = difference / distance if distance > zero else zero
            along_x[j] += factor * dx
            along_y[j] += factor * dy
            along_z[j] += factor * dz


@kernel
def _add_rows(axes, distances, weights, rows, gradient, loss):
    factor = np.empty(axes.shape[1], axes.dtype)
    for i in range(rows[0], rows[1]):
        _squared_distances(axes, i, factor)
        if len(weights) > 0:
            _weigh(factor, distances[i], weights[i], loss)
        else:
            _compare(factor, distances[i], loss)
        for axis in range(len(axes)):
            here = axes[axis, i]
            for j in range(len(factor)):
                gradient[axis, j] += factor[j] * (axes[axis, j] - here)


@kernel
def _squared_distances(axes, i, squared):
    here = axes[0, i]
    for j in range(len(squared)):
        apart = axes[0, j] - here
        squared[j] = apart * apart
    for axis in range(1, len(axes)):
        here = axes[axis, i]
        for j in range(len(squared)):
            apart = axes[axis, j] - here
            squared[j] += apart * apart


@kernel
def _compare(factor, given, loss):
    """Replace squared distances by 1 - delta / d, or 0 where d is 0; add (d - delta)^2 to `loss`."""
    zero = factor.dtype.type(0)
    for j in range(len(factor)):
        distance = np.sqrt(factor[j])
        difference = distance - given[j]
        loss[j] += difference * difference
        factor[j] = difference / distance if distance > zero else zero


@kernel
def _weigh(factor, given, weights, loss):
    """Do the same as `_compare` with weights."""
    zero = factor.dtype.type(0)
    for j in range(len(factor)):
        distance = np.sqrt(factor[j])
        difference = distance - given[j]
        weighted = weights[j] * difference
        loss[j] += weighted * difference
        factor[j] = weighted / distance if distance > zero else zero
