"""Comparison of signatures: measures, search, classification and evaluation."""
