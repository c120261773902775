"""Time and choices of pictures."""
