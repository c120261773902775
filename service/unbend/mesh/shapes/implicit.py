"""Rounded cones blended into one implicit surface, with exact gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unbend.arrays import Floats, Indices


@dataclass(frozen=True, eq=False)
class BlendedCones:
    """The union of rounded cones, in which only chosen pairs are blended.

    Parameters
    ----------
    starts, ends : (b, 3)
        Ends of each cone's axis.
    radii : (b, 2)
        Radii of the balls at the start and at the end; a rounded cone is the convex hull of two balls.
    pairs : (m, 2) int
        Pairs of cones that blend. All other cones meet in a crease where they overlap, so that limbs that come close do
        not grow together.
    blends : (m,)
        Width of the blend of each pair, the k of `_blended`.
    """

    starts: Floats
    ends: Floats
    radii: Floats
    pairs: Indices
    blends: Floats

    def distance(self, points: Floats) -> Floats:
        """Return the signed distance (n,) of points (n, 3), negative inside. Within a blend it is only a bound."""
        cones = np.stack([self._cone(bone, points)[0] for bone in range(len(self.starts))])
        result: Floats = cones.min(axis=0)
        for (first, second), blend in zip(self.pairs, self.blends, strict=True):
            np.minimum(result, _blended(cones[first], cones[second], blend)[0], out=result)
        return result

    def gradient(self, points: Floats) -> tuple[Floats, Floats]:
        """Return `distance` (n,) and its gradient (n, 3)."""
        cones, slopes = zip(*(self._cone(bone, points) for bone in range(len(self.starts))), strict=True)
        best = np.argmin(np.stack(cones), axis=0)
        distance, slope = np.stack(cones).min(axis=0), np.stack(slopes)[best, np.arange(len(points))]
        for (first, second), blend in zip(self.pairs, self.blends, strict=True):
            blended, weight = _blended(cones[first], cones[second], blend)
            mixed = (1 - weight)[:, None] * slopes[first] + weight[:, None] * slopes[second]
            nearer = blended < distance
            distance, slope = np.where(nearer, blended, distance), np.where(nearer[:, None], mixed, slope)
        return distance, slope

    def _cone(self, bone: int, points: Floats) -> tuple[Floats, Floats]:
        """Return the signed distance of one rounded cone (n,) and its gradient (n, 3).

        The cone is the union of the balls about a + tau u with radius r0 + sigma tau, 0 <= tau <= length. With y
        along the axis and x away from it, the nearest ball has (y - tau) / |p - centre| = -sigma, so
        tau = y + sigma x / sqrt(1 - sigma^2), clamped (the distance is convex in tau).
        """
        start, axis = self.starts[bone], self.ends[bone] - self.starts[bone]
        length = float(np.sqrt(axis @ axis))
        first, second = self.radii[bone]
        sigma = (second - first) / length
        unit = axis / length
        offset = points - start
        y = offset @ unit
        x = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - y * y, 0.0))
        tau = np.clip(y + sigma * x / np.sqrt(1 - sigma * sigma), 0.0, length)
        span = np.maximum(np.hypot(x, y - tau), 1e-300)
        return span - (first + sigma * tau), (offset - tau[:, None] * unit) / span[:, None]


def _blended(a: Floats, b: Floats, width: float) -> tuple[Floats, Floats]:
    """Return the quadratic smooth minimum min(a, b) - k h^2 / 4, h = max(1 - |a - b| / k, 0), and its derivative by b.

    Here k is `width`. The result differs from the minimum only where |a - b| < k (Quilez, "Smooth minimum"). The
    derivative by b is h / 2 where a < b, and 1 - h / 2 elsewhere.
    """
    h = np.maximum(1 - np.abs(a - b) / width, 0.0)
    return np.minimum(a, b) - width * h * h / 4, np.where(a < b, h / 2, 1 - h / 2)
