"""Helpers that several tests share: servers, oracles, meshes and checks."""
