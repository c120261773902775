"""Several descriptors at once, with fixed weights."""

from __future__ import annotations

from typing import Final

from unbend.matching.measures.protocol import VectorMeasure

COMBINED: Final = VectorMeasure(
    name="combined",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="spectrum, moments and distribution together, each as its own measure has it",
    parts=(("spectrum", 1.0), ("moments", 20.0), ("distribution", 5.0)),
)
"""For classes whose members are different objects, not one that bends.

`benchmarks/retrieval_choice.py` chose the weights on half of the classes.
"""
