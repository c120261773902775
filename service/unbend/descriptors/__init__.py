"""Descriptors: vectors computed from a signature, by which shapes are compared."""
