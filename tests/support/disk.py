"""A small mounted disk, for tests of a full disk."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def small_disk(folder: Path, megabytes: int) -> Iterator[Path]:
    """Mount a disk of this size at a folder; raise PermissionError if the user may not mount."""
    mount, unmount = shutil.which("mount"), shutil.which("umount")
    options = ["-t", "tmpfs", "-o", f"size={megabytes}m", "none", str(folder)]
    if not mount or not unmount or subprocess.run([mount, *options], capture_output=True, check=False).returncode:
        raise PermissionError(folder)
    try:
        yield folder
    finally:
        subprocess.run([unmount, "-l", str(folder)], check=True)
