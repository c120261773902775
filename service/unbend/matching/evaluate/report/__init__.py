"""The report of an evaluation: a single HTML page."""

from unbend.matching.evaluate.report.page import Report, render
from unbend.matching.evaluate.report.pictures import ShapePicture

__all__ = ["Report", "ShapePicture", "render"]
