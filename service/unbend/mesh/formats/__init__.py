"""File formats, a module for each: it recognises its files, announces their size, reads them and writes them."""

from __future__ import annotations

from typing import Final

FORMATS: Final = ("off", "obj", "ply", "stl", "glb")
"""The allow-list: single files, no archives, nothing that refers to other files."""
