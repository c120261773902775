"""off and obj files, written so that every coordinate reads back exactly.

trimesh writes a fixed number of decimals, which small surfaces do not survive, no colours in off, and names a material
file beside an obj with texture coordinates.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints


def obj_text(vertices: Floats, faces: Ints, colours: Floats | None, uv: Floats | None) -> str:
    """Return an obj file; `colours` (n, 3), from 0 to 1, follow the coordinates, and `uv` (n, 2) are `vt` lines."""
    corners = faces + 1
    parts = [_lines("v", vertices if colours is None else np.hstack([vertices, np.round(colours, 4)]))]
    if uv is None:
        parts.append(_lines("f", corners))
    else:
        parts += [_lines("vt", uv), _lines("f", np.repeat(corners, 2, axis=1), "%d/%d")]
    return "".join(parts)


def off_text(vertices: Floats, faces: Ints, colours: Floats | None) -> str:
    """Return an off file, or with `colours` (n, 3) a coff file: red, green, blue and alpha from 0 to 255."""
    header = f"{'OFF' if colours is None else 'COFF'}\n{len(vertices)} {len(faces)} 0\n"
    if colours is None:
        lines = _lines("", vertices)
    else:
        bytes_ = np.rint(255 * colours).astype(int)
        words = [" ".join(map(str, row)) for row in bytes_.tolist()]
        rows = zip(vertices.tolist(), words, strict=True)
        lines = "".join(f"{x!r} {y!r} {z!r} {word} 255\n" for (x, y, z), word in rows)
    return header + lines + _lines("3", faces)


def _lines(key: str, rows: NDArray[Any], item: str = "%r") -> str:
    per_row = rows.shape[1] // item.count("%")
    line = " ".join([key, *[item] * per_row] if key else [item] * per_row) + "\n"
    return line * len(rows) % tuple(rows.ravel().tolist())
