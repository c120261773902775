"""Distances beside peers, exact distances and damaged meshes."""
