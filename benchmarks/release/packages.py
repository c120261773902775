"""Builds the sdist and the wheel, checks them, and uses the wheel in fresh environments.

    python -m benchmarks.release.packages [FOLDER]

Needs the extra `release`. Runs `python -m build` and `twine check --strict`. Then installs the wheel with the oldest
supported Python, with the lowest and the highest versions of dependencies that pyproject.toml allows, and with the
newest Python of this machine. In each environment it computes a signature, ranks a query, draws a picture, uploads a
mesh to a server, and runs the tests that `Library`, `Client` and `AsyncClient` share. Writes the section "packages" of
docs/operations.md. Exits with an error if a step fails. Keeps the packages in FOLDER.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal

import httpx

from benchmarks.common import ROOT, table, write_section
from tests.support.server import ply, post_mesh, without_settings
from unbend.mesh.shapes import torus

PAGE: Final = ROOT / "docs" / "operations.md"
OLDEST: Final = 11
NEWEST: Final = 15  # minor versions of Python 3 that are looked for
SHOWN: Final = ("numpy", "scipy", "numba", "fastapi", "uvicorn", "pydantic", "sqlalchemy", "pillow")

ONE_API: Final = "tests/client/test_one_api.py"

Resolution = Literal["lowest-direct", "highest"]


def main() -> None:
    with TemporaryDirectory(prefix="unbend-release-") as name:
        folder = Path(name)
        packages = Path(sys.argv[1]) if sys.argv[1:] else folder / "packages"
        subprocess.run([sys.executable, "-m", "build", "--outdir", str(packages), str(ROOT)], check=True)
        built = sorted(packages.glob("unbend-*"))
        subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *map(str, built)], check=True)
        (wheel,) = (path for path in built if path.suffix == ".whl")
        pythons = found_pythons()
        plan: list[tuple[int, Resolution]] = [(OLDEST, "lowest-direct"), (OLDEST, "highest"), (max(pythons), "highest")]
        print(f"Python {sorted(pythons)} found; trying {plan}", flush=True)
        rows = []
        for number, (minor, resolution) in enumerate(plan):
            environment = Environment(folder / str(number), pythons[minor], wheel, resolution)
            environment.use(folder / f"use-{number}")
            environment.test()
            versions = environment.versions()
            rows.append((versions["python"], resolution, *(versions[name] for name in SHOWN)))
            write_section(PAGE, "packages", table(["Python", "Versions", *SHOWN], rows))


def found_pythons() -> dict[int, str]:
    """Return an interpreter of each minor version of Python 3 on this machine: on the path, or of pyenv."""
    found = {}
    for minor in range(OLDEST, NEWEST):
        folder = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
        places = [*sorted(folder.glob(f"3.{minor}.*/bin/python")), Path(f"python3.{minor}")]
        for place in map(str, places):
            try:
                subprocess.run([place, "-c", "import venv, ensurepip"], capture_output=True, check=True)
            except (OSError, subprocess.CalledProcessError):
                continue
            found[minor] = place
            break
    if OLDEST not in found:
        sys.exit(f"packages: no Python 3.{OLDEST} on this machine")
    return found


class Environment:
    """A fresh environment with the wheel."""

    def __init__(self, folder: Path, python: str, wheel: Path, resolution: Resolution) -> None:
        self.folder = folder
        uv, versions = str(Path(sysconfig.get_path("scripts"), "uv")), folder.with_suffix(".txt")
        subprocess.run([uv, "venv", "--quiet", "--python", python, str(folder)], check=True)
        own = str(self._path("python"))
        # The dependencies of a wheel count as indirect; those of pyproject.toml are direct.
        resolve = [uv, "pip", "compile", "--quiet", "--python", own, "--resolution", resolution, "-o", str(versions)]
        subprocess.run([*resolve, str(ROOT / "pyproject.toml")], stdout=subprocess.DEVNULL, check=True)
        install = [uv, "pip", "install", "--quiet", "--python", own, "--constraint", str(versions), str(wheel)]
        subprocess.run(install, check=True)

        self._uv = uv

    def test(self) -> None:
        """Run the tests of the one API against the installed package."""
        own = str(self._path("python"))
        subprocess.run([self._uv, "pip", "install", "--quiet", "--python", own, "hypothesis", "pytest"], check=True)
        # Old versions of dependencies warn of what later ones have changed.
        command = [own, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-o", "filterwarnings=", ONE_API]
        subprocess.run(command, cwd=ROOT, env=self._variables(), check=True)

    def _path(self, name: str) -> Path:
        return self.folder / "bin" / name

    def versions(self) -> dict[str, str]:
        """Return the versions of Python and of some dependencies."""
        code = (
            "import sys, importlib.metadata as m\n"
            "print('python', '.'.join(map(str, sys.version_info[:3])))\n"
            f"for name in {SHOWN}: print(name, m.version(name))"
        )
        lines = subprocess.run([self._path("python"), "-c", code], stdout=subprocess.PIPE, text=True, check=True).stdout
        return dict(line.split() for line in lines.splitlines())

    def use(self, folder: Path) -> None:
        """Use the installed package in the ways that most people do."""
        folder.mkdir()
        for number in range(3):
            label = folder / f"class-{number}"
            label.mkdir()
            for pose in range(2):
                (label / f"{pose}.ply").write_bytes(ply(torus(minor=0.2 + 0.1 * number, columns=12 + pose, rows=8)))
        mesh = folder / "class-0" / "0.ply"
        self._run(folder, "signature", str(mesh), "-o", "signature.ply", "--samples", "40")
        self._run(folder, "import", str(folder), "--label-from", "folder", "--library", "shapes.db", "--samples", "40")
        self._run(folder, "query", str(mesh), "--library", "shapes.db", "--samples", "40")
        self._run(folder, "show", str(mesh), "-o", "picture.png", "--size", "64x64")
        assert (folder / "picture.png").read_bytes().startswith(b"\x89PNG")
        self._serve(folder, mesh.read_bytes())

    def _run(self, folder: Path, *arguments: str) -> None:
        subprocess.run(
            self._command(*arguments), cwd=folder, env=self._variables(), stdout=subprocess.DEVNULL, check=True
        )

    def _command(self, *arguments: str) -> Sequence[str]:
        return [str(self._path("python")), "-W", "error::DeprecationWarning:unbend", "-m", "unbend", *arguments]

    def _variables(self) -> dict[str, str]:
        # The wheel is used, not the repository.
        return {name: value for name, value in without_settings().items() if not name.startswith(("PYTHON", "NUMBA"))}

    def _serve(self, folder: Path, mesh: bytes) -> None:
        log = folder / "server.log"
        with log.open("wb") as stream:
            command = self._command("serve", "--port", "0", "--library", "shapes.db", "--workers", "1")
            process = subprocess.Popen(command, cwd=folder, env=self._variables(), stdout=stream, stderr=stream)
        try:
            while not (address := re.search(r"running on (http://[\d.:]+)", log.read_text())):
                if process.poll() is not None:
                    sys.exit(log.read_text())
            with httpx.Client(base_url=address[1], timeout=600.0, trust_env=False) as http:
                job = post_mesh(http, mesh, parameters='{"samples": 50}').raise_for_status().json()
                while job["state"] in {"queued", "running"}:
                    job = http.get(f"/v1/jobs/{job['id']}", params={"wait": 30}).raise_for_status().json()
                assert job["state"] == "succeeded", job
                for path in ("/", "/docs", "/v1/metrics", f"/v1/shapes/{job['shape_id']}/thumbnail"):
                    http.get(path).raise_for_status()
        finally:
            process.terminate()
            process.wait()


if __name__ == "__main__":
    main()
