"""Copies of a whole library: backups, restores and exports."""
