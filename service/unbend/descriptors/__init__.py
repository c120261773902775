"""Descriptors: the vectors that stand for a signature when shapes are compared."""
