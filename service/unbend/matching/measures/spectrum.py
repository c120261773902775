"""The geodesic spectrum, compared in L1."""

from __future__ import annotations

from typing import Final

from unbend.matching.measures.protocol import VectorMeasure

SPECTRUM: Final = VectorMeasure(
    name="spectrum",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Smeets et al. 2012 (SD-GDM): eigenvalues of the geodesic distance matrix",
    parts=(("spectrum", 1.0),),
)
