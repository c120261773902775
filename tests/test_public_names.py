"""The public names of the package, and the cost of importing it."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import unbend
from unbend.extras import extra

NAMES = {
    "AsyncClient", "CanonicalForm", "Client", "Correspondence", "Embedding", "Flattening", "Library",
    "LocalSignatures", "MeshPolicy", "Parameters", "PictureRequest", "Signature", "Surface", "UnbendError",
    "VoronoiDiagram", "canonical_form", "compare", "compare_parts", "compute_file", "compute_signature",
    "effective_dimension", "embed", "farthest_point_sampling", "flatten", "geodesic_distances", "geodesic_matrix",
    "geodesic_path", "geodesic_voronoi", "iso_contours", "key_points", "load_signature", "local_signatures", "match",
    "read_mesh", "render_picture", "representation_errors", "save_signature", "symmetry", "transfer",
    "transfer_landmarks",
}  # fmt: skip

UNNEEDED = ("fastapi", "sqlalchemy", "sklearn", "joblib", "pandas", "matplotlib", "PIL", "jinja2")
"""Packages that neither signatures nor clients need."""


def test_the_public_names_are_listed_and_exist():
    assert set(unbend.__all__) == NAMES
    assert all(getattr(unbend, name) is not None for name in NAMES)
    assert dir(unbend) == sorted(NAMES)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nothing"):
        unbend.nothing  # noqa: B018


def imported_by(code: str, *modules: str) -> str:
    """Return those of `modules` that a new process has imported after it ran `code`."""
    code += f"; import sys; print([m for m in {modules} if m in sys.modules])"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_importing_the_package_imports_no_heavy_packages():
    assert imported_by("import unbend", "numba", "numpy", *UNNEEDED) == "[]"


@pytest.mark.parametrize(
    "use",
    [
        "unbend.compare(*[unbend.compute_signature(unbend.read_mesh(mesh), {'samples': 4})] * 2)",
        "unbend.Client('http://127.0.0.1:9').close()",
    ],
)
def test_signatures_and_clients_need_no_web_framework_database_or_extra(use):
    mesh = "mesh = ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])"
    assert imported_by(f"import unbend; {mesh}; {use}", *UNNEEDED) == "[]"


@pytest.mark.parametrize(
    ("module", "package", "name"),
    [("frames", "pandas", "pandas"), ("plot", "matplotlib", "plot"), ("sklearn", "sklearn", "sklearn")],
)
def test_a_missing_extra_is_named(module, package, name):
    code = f"""if True:
        import sys
        sys.modules[{package!r}] = None  # as if it were not installed
        import unbend
        try:
            import unbend.{module}
        except ImportError as error:
            print(isinstance(error, unbend.UnbendError), error.code, error)
    """
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    advice = (
        f"this needs the extra {name}, but {package} is not installed: "
        f"run pip install '.[{name}]' in the clone of unbend's repository"
    )
    assert out.stdout.strip() == f"True extra_missing {advice}"
    project = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]
    assert name in project["optional-dependencies"]


def test_an_error_within_an_installed_package_is_its_own():
    with pytest.raises(ModuleNotFoundError, match=r"json\.missing") as caught, extra("plot"):
        import_module("json.missing")
    assert not isinstance(caught.value, unbend.UnbendError)


def test_every_error_has_a_unique_code():
    def below(kind):
        return [kind, *(found for child in kind.__subclasses__() for found in below(child))]

    codes = [kind.code for kind in below(unbend.UnbendError)]
    assert len(set(codes)) == len(codes)
