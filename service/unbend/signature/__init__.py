"""The bending-invariant signature of a surface: parameters, pipeline, canonical form, export."""
