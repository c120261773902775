"""Marks and colours that tell curves, or classes, apart."""

from __future__ import annotations

from typing import Final

# Things differ in their marks as well as in their colours, of which the style sheet has as many.
MARKS: Final = (
    "M-3.6 0a3.6 3.6 0 1 0 7.2 0a3.6 3.6 0 1 0 -7.2 0z",  # disc
    "M-3.2-3.2h6.4v6.4h-6.4z",  # square
    "M0-4.2L4 3.2h-8z",  # triangle
    "M0-4.6L4.6 0L0 4.6L-4.6 0z",  # diamond
    "M0 4.2L4-3.2h-8z",  # triangle, on its tip
    "M-4-1.2h2.8v-2.8h2.4v2.8h2.8v2.4h-2.8v2.8h-2.4v-2.8h-2.8z",  # cross
)
