"""Which point of one surface is which point of another: match, symmetry, transfer."""
