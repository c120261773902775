"""Minimal geodesics: walk down a field, unfold the strip of triangles, pull the path tight."""
