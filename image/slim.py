"""Removes from an installed environment what a server never uses: `python slim.py /opt/unbend/venv`."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

_LOAD = "import ctypes, sys; ctypes.CDLL(sys.argv[1])"


def remove_tests(environment: Path) -> None:
    """Remove the tests of packages."""
    for folder in [path for path in environment.rglob("tests") if path.is_dir()]:
        shutil.rmtree(folder, ignore_errors=True)  # a folder may lie within one that is gone


def remove_bytecode(environment: Path) -> None:
    """Remove compiled modules."""
    for folder in list(environment.rglob("__pycache__")):
        shutil.rmtree(folder)


def strip_symbols(environment: Path) -> None:
    """Remove the symbols of extension modules that are only for debuggers, where the module still loads afterwards.

    `strip` damages some files that auditwheel has edited, among them most of the libraries in `*.libs`.
    """
    for path in sorted(environment.rglob("*.so")):
        if path.is_symlink() or path.parent.suffix == ".libs":
            continue
        original = path.with_suffix(".original")
        shutil.copy2(path, original)
        subprocess.run([str(shutil.which("strip")), "--strip-unneeded", str(path)], check=True)
        loads = subprocess.run([sys.executable, "-c", _LOAD, str(path)], capture_output=True, check=False)
        if loads.returncode:
            original.replace(path)
        else:
            original.unlink()


if __name__ == "__main__":
    for step in (remove_tests, strip_symbols, remove_bytecode):
        step(Path(sys.argv[1]))
