"""Reading, checking, repairing and writing meshes; analytic test surfaces."""
