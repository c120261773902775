"""Pieces of shapes: how often the right whole is found, and what it costs."""
