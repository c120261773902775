"""Multidimensional scaling: classical, least squares and fast; the stress of eq. 2."""
