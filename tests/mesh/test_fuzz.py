"""Damaged files of every format give a surface or a typed error, quickly and with little memory."""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.support.fuzzing import FORMATS, file_name, mutant, seeds
from unbend import Surface, read_mesh
from unbend.errors import MeshError
from unbend.mesh.limits import MeshLimits

COUNT = 300
SECONDS = 5.0  # of CPU; a file usually takes a millisecond
MEMORY = 2**29
LIMITS = MeshLimits(vertices=10_000, faces=10_000)


def limit() -> None:
    """Limit the process to `MEMORY` more bytes than it uses now, and turn warnings into errors."""
    for file_type in FORMATS:  # imports and compiles before the limits of memory and time apply
        read_mesh(seeds(file_type)[0])
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    warnings.simplefilter("error")


def read(file_type: str, number: int) -> Surface:
    hint = Path(file_name(file_type, number)).suffix
    return read_mesh(mutant(file_type, number), file_type=hint, limits=LIMITS)


def cpu_seconds_of_reading(file_type: str, number: int) -> float:
    begun = time.process_time()
    with contextlib.suppress(MeshError):
        read(file_type, number)
    return time.process_time() - begun


def examine(file_type: str) -> list[str]:
    """Read the mutants of a format; return the faults."""
    wrong, count = [], 0
    for number in range(COUNT):
        begun = time.process_time()
        try:
            surface = read(file_type, number)
            count += 1
            if not (np.isfinite(surface.vertices[surface.faces]).all() and surface.area > 0):
                wrong.append(f"{file_type} {number}: no finite surface")
        except MeshError as error:
            if not 0 < len(str(error)) < 500:
                wrong.append(f"{file_type} {number}: a message of {len(str(error))} characters")
        except Exception as error:  # noqa: BLE001  any other exception is a fault
            wrong.append(f"{file_type} {number}: {type(error).__name__}: {error}")
        # The first file that needs a kernel may compile it, so a slow file gets a second attempt.
        is_slow = time.process_time() - begun > SECONDS
        if is_slow and (seconds := cpu_seconds_of_reading(file_type, number)) > SECONDS:
            wrong.append(f"{file_type} {number}: {seconds:.0f} s")
    return wrong if count else [f"{file_type}: none of {COUNT} could be read"]


@pytest.fixture(scope="module")
def limited():
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), limit) as pool:
        yield pool


@pytest.mark.parametrize("file_type", FORMATS)
def test_every_damaged_file_gives_a_surface_or_a_typed_error(limited, file_type):
    assert limited.submit(examine, file_type).result() == []


def test_mutants_are_reproducible():
    assert mutant("ply", 17) == mutant("ply", 17) != mutant("ply", 17, seed=1)
