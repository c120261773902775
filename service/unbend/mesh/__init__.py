"""Reading, checking and repairing meshes; analytic test surfaces."""
