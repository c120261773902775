"""Scaling beside peers, its minima, and whole signatures."""
