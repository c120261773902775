"""A small disk of its own, for what happens when it is full."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def small_disk(folder: Path, megabytes: int) -> Iterator[Path]:
    """Mount a disk of so many megabytes at a folder; PermissionError where this user may not."""
    mount, unmount = shutil.which("mount"), shutil.which("umount")
    options = ["-t", "tmpfs", "-o", f"size={megabytes}m", "none", str(folder)]
    if not mount or not unmount or subprocess.run([mount, *options], capture_output=True, check=False).returncode:
        raise PermissionError(folder)
    try:
        yield folder
    finally:
        subprocess.run([unmount, "-l", str(folder)], check=True)
