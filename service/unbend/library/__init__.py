"""The library: shapes, signatures and jobs in a database, and search among the shapes."""

from unbend.library.library import Library

__all__ = ["Library"]
