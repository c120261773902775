"""Helpers of tests: servers, oracles, meshes, and checks that several tests share."""
