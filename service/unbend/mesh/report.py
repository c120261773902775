"""The report of reading a mesh: findings and repairs, in numbers and in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from unbend.brief import assigned, brief, changed, noted


@dataclass(frozen=True)
class MeshReport:
    """Counts of defects before repair, and in `notes` one sentence for each finding and repair.

    Vertices, faces and invalid faces are counted in the given mesh. Edges, loops, fans and orientations are counted in
    the kept faces after seams are joined, before smoothing, links and simplification.
    """

    file_type: str = ""
    vertices: int = 0
    faces: int = 0
    components: int = 0
    boundary_edges: int = 0
    nonmanifold_edges: int = 0
    degenerate_faces: int = 0
    """Faces that repeat a vertex; dropped."""
    duplicate_faces: int = 0
    """Faces with the corners of an earlier face, in any order; dropped."""
    isolated_vertices: int = 0
    notes: tuple[str, ...] = ()
    nonfinite_vertices: int = 0
    """Vertices that a face uses and that have a NaN or infinite coordinate."""
    nonfinite_faces: int = 0
    """Faces that use such a vertex; dropped."""
    zero_area_faces: int = 0
    """Faces of three different vertices on a line; kept, because they may connect other faces."""
    coincident_vertices: int = 0
    """Used vertices with the coordinates of a used vertex of lower index, after stitching; not joined."""
    boundary_loops: int = 0
    """Loops of boundary edges, around holes or the whole surface."""
    nonmanifold_vertices: int = 0
    """Vertices where several fans of faces meet."""
    misoriented_edges: int = 0
    """Edges whose two faces have different orientations; distances do not depend on orientations."""
    links: int = 0
    """Faces added to link components."""
    longest_link: float = 0.0
    """Length of the longest link, in units of the mesh."""
    link_area: float = 0.0
    """Area that links add, in squared units of the mesh."""
    roughness: float = 0.0
    """Rough estimate of the share of noise in the area before smoothing (see `unbend.mesh.roughness`)."""
    smoothing_rounds: int = 0
    area_change: float | None = None
    """Relative change of the area by smoothing, -0.1 for a tenth less; None without smoothing."""
    simplified_vertices: int | None = None
    """Vertices after simplification; None without it."""
    deviation: float | None = None
    """Largest distance of a vertex of the mesh from the simplified surface, in units of the mesh."""
    relative_deviation: float | None = None
    """`deviation` over the square root of the mesh's area."""
    seams: int = 0
    """Joined pairs of boundary edges."""
    seam_tolerance: float | None = None
    """Largest allowed distance of joined ends, in units of the mesh; None if all were equal."""
    area_kept: float = 1.0
    """Share of the area in the kept component; 1 if all components were kept."""
    warnings: tuple[str, ...] = ()
    """Reasons why the surface may differ from the intended shape, and what to do."""

    def __repr__(self) -> str:
        found = changed(self)
        sentences = [noted(len(found.pop(name, ())), name.removesuffix("s")) for name in ("notes", "warnings")]
        return brief(self, *assigned(found), *sentences)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain JSON values."""
        return asdict(self) | {"notes": list(self.notes), "warnings": list(self.warnings)}

    def adding(self, note: str | None = None, **counts: Any) -> MeshReport:
        """Return the report with further values and an optional note."""
        return replace(self, **counts, notes=(*self.notes, note) if note else self.notes)

    def warning(self, sentence: str) -> MeshReport:
        """Return the report with a further warning."""
        return replace(self, warnings=(*self.warnings, sentence))

    def described(self) -> MeshReport:
        """Return the report with a note for each nonzero count, before the other notes."""
        counted = [
            f"{counted_noun(count, one, many)}{rest}"
            for field, one, many, rest in _SENTENCES
            if (count := getattr(self, field)) > 0
        ]
        return replace(self, notes=(*counted, *self.notes))


def counted_noun(count: int, one: str, many: str) -> str:
    """Return a number with its noun: "1 face", "12,000 faces"."""
    return f"{count:,} {one if count == 1 else many}"


_SENTENCES: Final = (
    ("nonfinite_faces", "face", "faces", " with a coordinate that is not finite: dropped"),
    ("degenerate_faces", "face", "faces", " with a repeated vertex: dropped"),
    ("duplicate_faces", "duplicate face", "duplicate faces", ": dropped"),
    ("zero_area_faces", "face", "faces", " of zero area: kept"),
    ("isolated_vertices", "vertex", "vertices", " in no face: distances to them are infinite"),
    ("coincident_vertices", "vertex", "vertices", " with the coordinates of another: not joined"),
    ("seams", "pair", "pairs", " of coincident boundary edges: joined"),
    ("boundary_edges", "boundary edge", "boundary edges", ": the surface is open"),
    ("boundary_loops", "boundary loop", "boundary loops", ": holes or outer boundaries"),
    ("nonmanifold_edges", "edge", "edges", " with three faces or more"),
    ("nonmanifold_vertices", "vertex", "vertices", " where separate fans of faces meet"),
    ("misoriented_edges", "edge", "edges", " between faces of opposite orientation"),
)
