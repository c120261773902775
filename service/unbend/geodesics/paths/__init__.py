"""Minimal geodesics: descend a distance field, unfold the strip of triangles, pull the path tight."""
