"""The wheel: what it contains, and the types that its users get."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this tree, without the page, whose build has tests of its own."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)],
        cwd=ROOT, env=os.environ | {"UNBEND_WITHOUT_PAGE": "1"}, check=True, capture_output=True,
    )  # fmt: skip
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment with the wheel, and the dependencies of the present one."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    paths = sysconfig.get_paths(vars={"base": str(folder), "platbase": str(folder)})
    packages = Path(paths["purelib"])
    zipfile.ZipFile(wheel).extractall(packages)
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "bin" / "python"


def test_the_wheel_contains_every_file_of_the_package(wheel):
    folder = ROOT / "service"
    left_out = {"__pycache__", "page"}
    expected = {
        str(path.relative_to(folder))
        for path in (folder / "unbend").rglob("*")
        if path.is_file() and not left_out & {part.name for part in path.parents}
    }
    contained = {name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("unbend/")}
    assert {name for name in contained if "/api/page/" not in name} == expected
    assert "unbend/py.typed" in contained


def test_the_examples_of_the_pages_have_valid_types(installed, tmp_path):
    files = []
    for page in PAGES:
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
        if blocks:  # later examples of a page may use names of earlier ones
            files.append(tmp_path / f"{page.stem}_examples.py")
            files[-1].write_text("\n".join(blocks))
    assert files
    untyped = "[mypy-sklearn.*]\nignore_missing_imports = true\n"
    (tmp_path / "mypy.ini").write_text(f"[mypy]\nallow_untyped_globals = true\n{untyped}")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--python-executable", str(installed), "--cache-dir", str(tmp_path / "cache"),
         "--config-file", str(tmp_path / "mypy.ini"), *map(str, files)],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


def test_a_wrong_type_is_found(installed, tmp_path):
    """The types are those of the installed package: a mistake in its use is an error, so the test above can fail."""
    path = tmp_path / "wrong.py"
    path.write_text("import unbend\nunbend.Library('a.db').rank('b.ply').classes[0].label.nothing\n")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--python-executable", str(installed), "--cache-dir", str(tmp_path / "cache"),
         str(path)],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert '"str" has no attribute "nothing"' in done.stdout
