"""Moments: of the signature, which do not feel bending, and of the surface as it stands, which do."""

from __future__ import annotations

from typing import Final

from unbend.matching.measures.protocol import VectorMeasure

MOMENTS: Final = VectorMeasure(
    name="moments",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Elad & Kimmel 2003, section 2.3, after Tal & Elad: moments of the signature surface",
    parts=(("moments", 1.0),),
)

SURFACE_MOMENTS: Final = VectorMeasure(
    name="surface_moments",
    invariances=("rotation", "reflection", "scale"),
    reference="the same moments of the surface as it stands: what the paper's Fig. 8 compares with",
    parts=(("surface_moments", 1.0),),
)
