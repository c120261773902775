"""The bending-invariant signature of a surface: parameters, computation, canonical form, export."""
