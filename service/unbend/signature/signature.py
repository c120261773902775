"""The type of a bending-invariant signature."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints, frozen
from unbend.brief import assigned, brief, changed, counted_points, noted
from unbend.local.signatures import LocalSignatures
from unbend.notebook.pictured import Pictured
from unbend.signature.parameters import Parameters

ALGORITHM_VERSION: Final = "5"
"""Version of the algorithm. It changes when the same mesh and parameters give different numbers than before."""


@dataclass(frozen=True, eq=False)
class Signature(Pictured):
    """A bending-invariant signature: samples of a surface, placed so that distances approximate geodesic distances."""

    points: Floats
    """Canonical coordinates of the samples, (k, m), in the unit that `parameters.scaling` names."""
    faces: Ints
    """Triangles between samples, (f, 3), which remain when the surface's vertices are collapsed onto samples."""
    samples: Indices
    """Vertex of the surface for each point, (k,)."""
    weights: Floats
    """Share of the surface's area that is nearest to each sample, (k,). The shares sum to 1."""
    scale: float
    """Length in the unit of the surface that corresponds to 1 in `points`."""
    stress: float
    """Eq. 2: the difference between the distances of the points and the geodesic distances; 0 if they are equal."""
    asymmetry: float
    """Largest difference between the two directions of a marched distance, over the largest distance."""
    descriptors: dict[str, Floats]
    """Vectors for comparison, by name."""
    parameters: Parameters = field(default_factory=Parameters)
    version: str = ALGORITHM_VERSION
    warnings: tuple[str, ...] = ()
    """Reasons why the signature may be wrong, and remedies. Warnings from reading the surface come first."""
    boundary: float | None = None
    """Length of the surface's boundary over the square root of its area; None in signatures of earlier libraries."""
    local: LocalSignatures | None = None
    """Local signatures, by which pieces are recognised; None unless they were asked for."""

    def __post_init__(self) -> None:
        kinds = {"points": np.float64, "faces": np.int32, "samples": np.int64, "weights": np.float64}
        for name, kind in kinds.items():
            object.__setattr__(self, name, frozen(getattr(self, name), kind))
        vectors = {name: frozen(vector, np.float64) for name, vector in self.descriptors.items()}
        object.__setattr__(self, "descriptors", vectors)

    def __repr__(self) -> str:
        chosen = {"samples": self.parameters.samples, **changed(self.parameters)}
        return brief(
            self, counted_points(self.points.shape), f"stress {self.stress:.3g}",
            *assigned(chosen), f"version {self.version}", noted(len(self.warnings), "warning"),
        )  # fmt: skip

    @property
    def moments(self) -> Floats:
        """Second and third order moments of the signature, (14,)."""
        return self.descriptors["moments"]

    @property
    def spectrum(self) -> Floats:
        """Geodesic spectrum, (120,)."""
        return self.descriptors["spectrum"]

    @property
    def distribution(self) -> Floats:
        """Quantiles of the geodesic distances and of the distances in the signature, (128,)."""
        return self.descriptors["distribution"]

    @property
    def dimension(self) -> int | None:
        """Effective dimension, 1 to 12, itself a bending invariant (section 3); None in signatures of version 4."""
        return int(self.descriptors["dimension"][0]) if "dimension" in self.descriptors else None

    @property
    def representation_errors(self) -> Floats | None:
        """Eq. 6 in 1 to 6 dimensions, (6,); None in signatures of version 4."""
        return self.descriptors["dimension"][1:] if "dimension" in self.descriptors else None

    @property
    def surface_moments(self) -> Floats:
        """Moments of the surface itself, which are not bending-invariant, for comparison."""
        return self.descriptors["surface_moments"]
