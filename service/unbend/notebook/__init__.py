"""What notebooks show of values and results, as HTML without scripts or links: it works offline and in saved files."""
