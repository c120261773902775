"""Shape distributions, compared by the earth mover's distance."""

from __future__ import annotations

from typing import Final

from unbend.matching.measures.protocol import VectorMeasure

DISTRIBUTION: Final = VectorMeasure(
    name="distribution",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Osada et al. 2001 (D2), of geodesic distances and of distances in the signature",
    parts=(("distribution", 1.0),),
)
