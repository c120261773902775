"""What reading a mesh found and did, in numbers and in plain words."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class MeshReport:
    """Counts of what a file held, before repair, and one sentence for each thing that was done about it."""

    file_type: str = ""
    vertices: int = 0
    faces: int = 0
    components: int = 0
    boundary_edges: int = 0
    nonmanifold_edges: int = 0
    degenerate_faces: int = 0
    duplicate_faces: int = 0
    isolated_vertices: int = 0
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """Return the report as plain JSON values."""
        return asdict(self) | {"notes": list(self.notes)}
