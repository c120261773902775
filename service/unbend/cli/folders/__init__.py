"""Folders of meshes, and many meshes at a time: found, computed on all cores, imported, evaluated, accounted for."""
