"""The report of an evaluation: one page of HTML."""

from unbend.matching.evaluate.report.page import Report, render

__all__ = ["Report", "render"]
