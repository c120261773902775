"""Comparing signatures: measures, ranking, nearest class, retrieval figures."""
