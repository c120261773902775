"""Measurements of a library in PostgreSQL, and of what surrounds it."""
