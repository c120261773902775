"""Shards: files of results that were computed without a library, such as by the jobs of a cluster."""
