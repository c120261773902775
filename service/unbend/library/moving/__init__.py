"""Moves of a whole library between databases."""
