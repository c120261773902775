"""Storage: the database, its one writer, its caches and its disk."""
