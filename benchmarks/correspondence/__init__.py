"""Correspondences between real shapes, against their truth."""
