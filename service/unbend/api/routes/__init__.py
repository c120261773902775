"""The endpoints, one module for each kind of resource, and their common helpers."""
