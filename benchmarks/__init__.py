"""Benchmarks: measured comparisons, whose tables are in docs/. `python -m benchmarks` lists them."""
