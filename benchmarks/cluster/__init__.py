"""Benchmarks of a cluster on PostgreSQL."""
