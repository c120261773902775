"""Which point of a whole is which point of a piece of it."""
