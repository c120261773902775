"""Benchmarks of correspondences against the truth and another library."""
