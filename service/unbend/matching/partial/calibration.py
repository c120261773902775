"""The constants of confidences and of unknown pieces.

`benchmarks/partial/calibrate.py` chooses them on half of the classes of SHREC'11 and reports on the other half.
"""

from __future__ import annotations

from typing import Final

EXPONENT: Final = 8.0
"""The exponent with which the confidence of a class falls with its distance."""

KNOWN: Final = 1.6
"""The largest distance of a piece from a shape of its class."""
