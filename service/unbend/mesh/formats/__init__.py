"""File formats: which one some bytes are, and what each needs before and after trimesh reads it."""
