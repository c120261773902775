"""Benchmarks of multidimensional scaling against other libraries, of its local minima, and of whole signatures."""
