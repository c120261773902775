"""The measures that compare vectors, each made of one or several descriptors.

To add a measure, define a `VectorMeasure` here and list it in `unbend.matching.measures.registry`. All these measures
are invariant to rotation, reflection and scale. All except `SURFACE_MOMENTS` are also invariant to bending.
"""

from __future__ import annotations

from typing import Final

from unbend.matching.measures.protocol import VectorMeasure

SPECTRUM: Final = VectorMeasure("spectrum", parts=(("spectrum", 1.0),))
"""Eigenvalues of the geodesic distance matrix (Smeets et al. 2012: SD-GDM)."""

COMBINED: Final = VectorMeasure("combined", parts=(("spectrum", 1.0), ("moments", 20.0), ("distribution", 5.0)))
"""Spectrum, moments and distribution together, for classes of different objects instead of poses of one object.

`benchmarks/retrieval/choice.py` chose the weights on half of the classes.
"""

MOMENTS: Final = VectorMeasure("moments", parts=(("moments", 1.0),))
"""Moments of the signature surface (Elad & Kimmel 2003, section 2.3, after Tal & Elad)."""

DISTRIBUTION: Final = VectorMeasure("distribution", parts=(("distribution", 1.0),))
"""Distributions of geodesic distances and of distances in the signature (Osada et al. 2001: D2).

The descriptor is made of quantiles, so the L1 distance is the earth mover's distance.
"""

DIMENSION: Final = VectorMeasure("dimension", parts=(("dimension", 1.0),))
"""The effective dimension m, and the errors of eq. 6 for m = 1 to 6 (Elad & Kimmel 2003, section 3).

This is the coarsest bending invariant.
"""

SURFACE_MOMENTS: Final = VectorMeasure("surface_moments", parts=(("surface_moments", 1.0),))
"""Moments of the original surface, which change when it bends. The paper's Fig. 8 uses them for comparison."""
