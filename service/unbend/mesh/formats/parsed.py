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
    """Return the note on what follows the end of a file's mesh: so many bytes or lines."""
    return (f"{counted_noun(count, noun, noun + 's')} behind the end skipped",) if count > 0 else ()


def words_cut(lines: int) -> tuple[str, ...]:
    """Return the note on lines that end in words that are no numbers."""
    return (f"words skipped that are no numbers, at the end of {counted_noun(lines, 'line', 'lines')}",)


@dataclass(frozen=True)
class MeshFormat:
    """One file format.

    Its functions are given whole files. `read` raises MeshReadError where a file is damaged, MeshFormatError where it
    is of a kind that is not read, and MeshTooLargeError; what else it raises means damage, too.
    """

    name: str
    recognises: Callable[[bytes], bool]
    """Whether the content shows the format, in linear time: servers ask before they queue a file."""
    announced: Callable[[bytes], tuple[int, int]]
    """How many vertices and faces the file says it has, or has lines for, found at the speed of a search; 0 where
    unknown. It may be a lie: `read` counts again. Faces are polygons where the format has them."""
    read: Callable[[bytes, MeshLimits], ParsedMesh]
    write: Callable[[Floats, Ints, Floats | None, Floats | None], bytes] | None = None
    """Makes a file of finite vertices (n, 3), faces (m, 3), and colours (n, 3) from 0 to 1 and texture coordinates
    (n, 2) where there are any. None for formats in which vertices cannot be shared."""
