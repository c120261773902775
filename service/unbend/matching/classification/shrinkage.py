"""A covariance from few samples: shrunk towards a multiple of the identity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from unbend.arrays import Floats


@dataclass(frozen=True)
class Metric:
    """The inverse of a covariance diag(variances) - share * lost lost^T, never formed."""

    variances: Floats
    """(d,), above 0."""
    lost: Floats
    """(d, k)."""
    share: float

    @classmethod
    def of(cls, scatter: Floats, lost: Floats, freedom: int) -> Self:
        """Shrink the covariance S / `freedom`, where S is diag(`scatter`) - `lost` `lost`^T, by the oracle's share.

        Parameters
        ----------
        scatter : (d,) float64
        lost : (d, k) float64
            What some samples added to S that are left out now: so these need no other axes.
        freedom : int
            Samples less the means that were taken from them.

        Notes
        -----
        The share (Chen et al. 2010, eq. 23) takes no more than two traces, so it is exactly that of the samples
        that stay. Where these do not differ at all, nothing is known of axes, and all are taken alike.
        """
        dimension = len(scatter)
        trace = float(scatter.sum() - (lost**2).sum())
        if trace <= dimension * np.finfo(float).eps * scatter.sum():
            return cls(np.ones(dimension), lost, 0.0)
        squared = float((scatter**2).sum() - 2 * (scatter @ lost**2).sum() + ((lost.T @ lost) ** 2).sum())
        shrinkage = _shrinkage(trace, squared, dimension, freedom)
        share = (1 - shrinkage) / freedom
        return cls(share * scatter + shrinkage * trace / (dimension * freedom), lost, share)

    def lengths(self, differences: Floats) -> Floats:
        """Return the Mahalanobis length of each row of `differences` (n, d), as (n,)."""
        scaled = differences / self.variances
        squares = np.einsum("nd,nd->n", scaled, differences)
        # Woodbury's identity
        seen = scaled @ self.lost
        between = np.eye(self.lost.shape[1]) - self.share * self.lost.T @ (self.lost / self.variances[:, None])
        squares += self.share * np.einsum("nk,kn->n", seen, np.linalg.solve(between, seen.T))
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


def _shrinkage(trace: float, squared: float, dimension: int, freedom: int) -> float:
    """Return the share of the identity, 0 to 1, from the traces of S and S S."""
    excess = (freedom + 1 - 2 / dimension) * (squared - trace**2 / dimension)
    return min(1.0, ((1 - 2 / dimension) * squared + trace**2) / excess) if excess > 0 else 1.0
