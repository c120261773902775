"""The report of an evaluation: a single HTML page."""

from unbend.matching.evaluate.report.page import Report, render

__all__ = ["Report", "render"]
