"""Comparison of signatures: distances, search, classification and retrieval metrics."""
