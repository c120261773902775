"""Descriptors: vectors that describe a shape, for the comparison of shapes."""
