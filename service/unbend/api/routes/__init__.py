"""The calls of the HTTP contract, a module for each kind of thing."""
