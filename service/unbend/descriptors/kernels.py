"""Functions of distance whose eigenvalues describe a surface, at several scales."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from unbend.arrays import Floats
from unbend.tolerances import DENSITY_FLOOR

Kernel = Callable[[Floats, Floats], Floats]
"""Takes distances (k, k) on a surface of area 1 and the samples' shares of the area (k,); returns a matrix (k, k)."""


def power(exponent: float) -> Kernel:
    """Return d^p: how the whole surface lies; p = 1 is the geodesic distance matrix of Smeets et al. 2012."""
    return lambda distances, _shares: np.asarray(distances**exponent)


def three_quarters(distances: Floats, _shares: Floats) -> Floats:
    """Return d^0.75, as `power(0.75)`, without a logarithm for each."""
    return np.asarray(np.sqrt(distances * np.sqrt(distances)))


def exponential(rate: float) -> Kernel:
    """Return exp(-t d)."""
    return lambda distances, _shares: np.asarray(np.exp(-rate * distances))


def gaussian(width: float) -> Kernel:
    """Return exp(-(d / s)^2): what lies within a distance of about s."""
    return lambda distances, _shares: np.asarray(np.exp(-((distances / width) ** 2)))


def diffusion(width: float) -> Kernel:
    """Return the random walk of a Gaussian step, in its symmetric form, freed from how dense the samples are.

    Coifman & Lafon, "Diffusion maps" (2006), section 3.4, with alpha = 1: the logarithms of its eigenvalues tend to
    those of the Laplace-Beltrami operator times -s^2 / 4, as samples grow denser and s smaller.
    """
    affinity = gaussian(width)

    def walk(distances: Floats, shares: Floats) -> Floats:
        near = affinity(distances, shares)
        density = np.maximum(near @ shares, DENSITY_FLOOR)
        near /= np.outer(density, density)
        degree = np.sqrt(np.maximum(near @ shares, DENSITY_FLOOR))
        return np.asarray(near / np.outer(degree, degree))

    return walk
