"""The type that readers return, and the type that describes a format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from unbend.arrays import Floats, Indices, Ints
from unbend.mesh.limits import MeshLimits
from unbend.mesh.report import counted_noun


@dataclass(frozen=True)
class ParsedMesh:
    """The triangles of a file. No vertex is merged, dropped or renumbered."""

    vertices: Floats
    """(n, 3)"""
    faces: Indices
    """(m, 3)"""
    notes: tuple[str, ...] = ()
    """One sentence for each kind of content that the reader skipped or changed."""


def left_over(count: int, noun: str) -> tuple[str, ...]:
    """Return a note on `count` bytes or lines after the end of the mesh, no note for 0."""
    return (f"{counted_noun(count, noun, noun + 's')} after the end skipped",) if count > 0 else ()


def words_cut(lines: int) -> tuple[str, ...]:
    """Return a note on `lines` lines that ended in words that are not numbers."""
    return (f"words that are not numbers skipped at the end of {counted_noun(lines, 'line', 'lines')}",)


@dataclass(frozen=True)
class MeshFormat:
    """One file format.

    The functions take whole files. `read` raises MeshReadError for a damaged file, MeshFormatError for an unsupported
    variant of the format, and MeshTooLargeError. Any other exception also means damage.
    """

    name: str
    recognises: Callable[[bytes], bool]
    """Returns whether the content shows the format. Linear time, because servers call it before they queue a file."""
    announced: Callable[[bytes], tuple[int, int]]
    """Returns the numbers of vertices and faces that a header announces or that a search for lines finds; 0 if unknown.
    The numbers may be wrong, so `read` counts again. Polygons count as one face."""
    read: Callable[[bytes, MeshLimits], ParsedMesh]
    write: Callable[[Floats, Ints, Floats | None, Floats | None], bytes] | None = None
    """Returns a file from finite vertices (n, 3), faces (m, 3), and optional colours (n, 3) from 0 to 1 and texture
    coordinates (n, 2). None if faces cannot share vertices in the format."""
