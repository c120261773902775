"""The modules, and the kernels on disk, that the fork server of workers loads once for all of them."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import shutil
import time
from multiprocessing import forkserver
from pathlib import Path
from typing import Final

# Before NumPy is imported: each worker has one core, and a process must not be forked while it has threads.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

from unbend.jit import without_compiling  # noqa: E402
from unbend.jobs import batch, worker  # noqa: E402, F401  all that workers run, with the next module
from unbend.library import computed  # noqa: E402, F401

_PATIENCE_SECONDS: Final = 1.0

with contextlib.suppress(Exception), without_compiling():  # each worker does what is missing, and reports what fails
    worker.warm_up()


@atexit.register
def remove_socket(fork_server: int = os.getpid(), parent: int = os.getppid()) -> None:
    """Remove the folder with the socket of this fork server, for a parent that was killed."""
    if os.getpid() != fork_server:  # a forked worker
        return
    end = time.monotonic() + _PATIENCE_SECONDS
    while os.getppid() == parent:  # a parent that ends closes its files first
        if time.monotonic() > end:
            return  # it lives, and removes the folder itself
        time.sleep(0.01)
    address = forkserver._forkserver._forkserver_address  # type: ignore[attr-defined]  # noqa: SLF001  no public name
    if address:
        shutil.rmtree(Path(address).parent, ignore_errors=True)


gc.freeze()  # a garbage collection would write to these objects, and so copy their memory for each worker
