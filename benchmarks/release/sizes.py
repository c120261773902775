"""Measures what makes the container's image smaller.

    python -m benchmarks.release.sizes WHEEL

Installs a wheel in a fresh environment as the Dockerfile does, and takes the steps of `image/slim.py` and of the
Dockerfile one after another. Needs `strip` and the extra `release`. Writes the section "sizes" of docs/operations.md.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from benchmarks.common import ROOT, table, write_section
from benchmarks.release.image import size

sys.path.insert(0, str(ROOT / "image"))
import slim

PAGE: Final = ROOT / "docs" / "operations.md"


def main() -> None:
    with TemporaryDirectory(prefix="unbend-sizes-") as name:
        environment = Path(name, "venv")
        python = environment / "bin" / "python"
        subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--compile", sys.argv[1]], check=True)
        rows = [("the wheel and its dependencies, as `pip install` leaves them", f"{size(environment):.0f}")]
        uninstall = [python, "-m", "pip", "uninstall", "--quiet", "--yes", "pip"]
        for step, run in {
            "without pip: `venv --without-pip`": lambda: subprocess.run(uninstall, check=True),
            "without bytecode: `pip install --no-compile`": lambda: slim.remove_bytecode(environment),
            "without the tests of packages": lambda: slim.remove_tests(environment),
            "without symbols of extension modules: `strip`": lambda: slim.strip_symbols(environment),
            "with the bytecode of the modules that a server imports": lambda: start(python),
        }.items():
            run()
            rows.append((step, f"{size(environment):.0f}"))
    write_section(PAGE, "sizes", table(["Environment", "MB"], rows))


def start(python: Path) -> None:
    """Import what a server and its workers import."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    code = "import unbend.api.app, unbend.jobs.kernels, unbend.api.server.connections, unbend.api.server.serving"
    subprocess.run([python, "-c", code], env=variables, cwd="/", check=True)


if __name__ == "__main__":
    main()
