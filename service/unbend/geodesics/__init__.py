"""Geodesic distances by fast marching on triangulated domains; farthest point sampling; the distance matrix."""
