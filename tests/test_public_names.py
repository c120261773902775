"""The public names of the package, and the cost of importing it."""

from __future__ import annotations

import subprocess
import sys

import pytest

import unbend

NAMES = {
    "AsyncClient", "CanonicalForm", "Client", "Correspondence", "Embedding", "Flattening", "Library",
    "LocalSignatures", "MeshPolicy", "Parameters", "PictureRequest", "Signature", "Surface", "UnbendError",
    "VoronoiDiagram", "canonical_form", "compare", "compare_parts", "compute_signature", "effective_dimension",
    "embed", "farthest_point_sampling", "flatten", "geodesic_distances", "geodesic_matrix", "geodesic_path",
    "geodesic_voronoi", "iso_contours", "key_points", "load_signature", "local_signatures", "match", "read_mesh",
    "render_picture", "representation_errors", "save_signature", "symmetry", "transfer", "transfer_landmarks",
}  # fmt: skip


def test_the_public_names_are_listed_and_exist():
    assert set(unbend.__all__) == NAMES
    assert all(getattr(unbend, name) is not None for name in NAMES)
    assert dir(unbend) == sorted(NAMES)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nothing"):
        unbend.nothing  # noqa: B018


def test_importing_the_package_imports_no_heavy_packages():
    code = "import sys, unbend; print([m for m in ('fastapi', 'sqlalchemy', 'numba', 'numpy') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_every_error_has_a_unique_code():
    def below(kind):
        return [kind, *(found for child in kind.__subclasses__() for found in below(child))]

    codes = [kind.code for kind in below(unbend.UnbendError)]
    assert len(set(codes)) == len(codes)
