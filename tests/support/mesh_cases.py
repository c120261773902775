"""Files of other programs that earlier versions refused or misread, with their expected results."""

from __future__ import annotations

from pathlib import Path

CASES = Path(__file__).parents[1] / "mesh" / "cases"
OCTAHEDRON = 9.407521
AREAS = {
    "dart1.obj": 1, "obj_concave_pentagon.obj": 10, "ply_concave_pentagon.ply": 10, "hexprism.off": 11.196152,
    "glb_flat_cube_24.glb": 52, "glb_no_indices.glb": OCTAHEDRON, "glb_skinned_node_scaled.glb": OCTAHEDRON,
    "glb_skinned_body_and_prop.glb": 1.01 * OCTAHEDRON, "glb_sparse_only.glb": OCTAHEDRON,
    "obj_bom_v_first.obj": OCTAHEDRON, "obj_bom_spare_vertex.obj": OCTAHEDRON, "obj_comment_after_f.obj": OCTAHEDRON,
    "obj_comment_ends_backslash.obj": OCTAHEDRON, "obj_continuation_trailing_space.obj": OCTAHEDRON,
    "obj_two_corner_face.obj": OCTAHEDRON, "off_wrapped_lines.off": OCTAHEDRON, "off_lowercase.off": OCTAHEDRON,
    "off_4off.off": OCTAHEDRON, "off_binary.off": OCTAHEDRON, "off_edge_faces.off": OCTAHEDRON,
    "ply_bin_cr_header.ply": OCTAHEDRON, "ply_face_one_corner_bin.ply": OCTAHEDRON,
    "ply_face_zero_corners.ply": OCTAHEDRON, "ply_tristrips.ply": OCTAHEDRON, "ply_trailing_bytes.ply": OCTAHEDRON,
    "ply_flat_cube_24.ply": 52, "stl_bin_trailing.stl": OCTAHEDRON, "stl_ascii_bom.stl": OCTAHEDRON,
    "stl_end_solid_two_words.stl": OCTAHEDRON, "stl_no_endsolid.stl": OCTAHEDRON,
    "stl_noise_last_digit.stl": OCTAHEDRON, "det_ply_panel.stl": OCTAHEDRON, "det_glued": OCTAHEDRON,
}  # fmt: skip
NOTES = {
    "glb_skinned_node_scaled.glb": "1 mesh with a skin",
    "glb_skinned_body_and_prop.glb": "2 instances of 2 meshes",
    "obj_two_corner_face.obj": "1 face of fewer than three corners skipped",
    "off_edge_faces.off": "1 face of fewer than three corners skipped",
    "ply_face_one_corner_bin.ply": "1 face of fewer than three corners skipped",
    "ply_face_zero_corners.ply": "1 face of fewer than three corners skipped",
    "ply_trailing_bytes.ply": "11 bytes after the end skipped",
    "stl_bin_trailing.stl": "92 bytes after the end skipped",
    "stl_no_endsolid.stl": "no end",
}
REFUSED = {"obj_utf16.obj": "UTF-16"}


def surface_area_of(name: str) -> float:
    """Return the area of the component that reading keeps."""
    return OCTAHEDRON if name == "glb_skinned_body_and_prop.glb" else AREAS[name]
