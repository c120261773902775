"""Values and results as notebooks show them: HTML without scripts or links, which works offline and in saved files."""
