"""Benchmarks of geodesic distances against other libraries, against exact distances, and on damaged meshes."""
