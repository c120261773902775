"""The values that readers return, and the description of a format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from unbend.arrays import Floats, Indices, Ints
from unbend.mesh.limits import MeshLimits
from unbend.mesh.report import counted_noun


@dataclass(frozen=True)
class ParsedMesh:
    """The triangles of a file as they stand in it: no vertex is merged, dropped or renumbered."""

    vertices: Floats
    """(n, 3)"""
    faces: Indices
    """(m, 3)"""
    notes: tuple[str, ...] = ()
    """A sentence for each thing that the reader skipped or chose."""


def left_over(count: int, noun: str) -> tuple[str, ...]:
    """Return the note on `count` bytes or lines that follow the end of the mesh; none for 0."""
    return (f"{counted_noun(count, noun, noun + 's')} behind the end skipped",) if count > 0 else ()


def words_cut(lines: int) -> tuple[str, ...]:
    """Return the note on lines that end in words which are not numbers."""
    return (f"words skipped that are no numbers, at the end of {counted_noun(lines, 'line', 'lines')}",)


@dataclass(frozen=True)
class MeshFormat:
    """One file format.

    Its functions take whole files. `read` raises MeshReadError for a damaged file, MeshFormatError for a kind of file
    that is not read, and MeshTooLargeError; any other exception means damage, too.
    """

    name: str
    recognises: Callable[[bytes], bool]
    """Says whether the content shows the format. It takes linear time, because servers ask before they queue a file."""
    announced: Callable[[bytes], tuple[int, int]]
    """Returns how many vertices and faces the file says it has, or has lines for; 0 where unknown. It is as fast as a
    search. The file may lie, so `read` counts again. Faces are polygons where the format has them."""
    read: Callable[[bytes, MeshLimits], ParsedMesh]
    write: Callable[[Floats, Ints, Floats | None, Floats | None], bytes] | None = None
    """Returns a file of finite vertices (n, 3), faces (m, 3), and optional colours (n, 3) from 0 to 1 and texture
    coordinates (n, 2). None for formats in which faces cannot share vertices."""
