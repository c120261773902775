"""The library: shapes, signatures and jobs in a database, and search among the shapes."""

from unbend.library.library import Library
from unbend.library.search.ranking import Ranking

__all__ = ["Library", "Ranking"]
