"""How many dimensions shapes need: the coarsest bending invariant of all."""

from __future__ import annotations

from typing import Final

from unbend.matching.measures.protocol import VectorMeasure

DIMENSION: Final = VectorMeasure(
    name="dimension",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Elad & Kimmel 2003, section 3: the effective dimension m, and the errors of eq. 6 for m = 1 to 6",
    parts=(("dimension", 1.0),),
)
