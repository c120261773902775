"""Retrieval, classification and robustness on real shapes."""
