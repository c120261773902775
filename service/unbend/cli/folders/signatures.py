"""The signatures of many meshes as files, computed on all cores."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

from unbend.cli.folders.account import Ended
from unbend.cli.folders.computing import Machine
from unbend.cli.folders.files import LabelledFile
from unbend.cli.options import Values
from unbend.errors import UnbendError
from unbend.jobs.batch import Batch, SignatureFile, compute_signature_file, outcome_of
from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters


def write_signatures(
    files: Iterator[LabelledFile],
    count: int,
    root: Path,
    output: Path,
    file_type: str,
    whole: bool,
    machine: Machine,
    parameters: Values,
    policy: Values,
) -> Generator[Ended]:
    """Write the signatures of `count` files below `root` to the same places below `output`, and yield each file.

    Raises
    ------
    ParameterError
        If the parameters or the policy are invalid.
    """
    chosen = Parameters.from_dict(parameters), MeshPolicy.from_dict(policy)
    with Batch(machine.workers, machine.memory_mb, count) as batch:
        compute = partial(compute_signature_file, file_type=file_type, whole=whole, threads=batch.threads)
        started = ((file.path, batch.submit(compute, file.path, *chosen)) for file in files)
        for ready in batch.settled(started):
            for path, future in ready:
                target = output / f"{os.path.relpath(path, root)}.{file_type}"
                outcome = outcome_of(future)
                yield _written(path, outcome, target)


def _written(path: Path, found: SignatureFile | UnbendError, target: Path) -> Ended:
    if isinstance(found, UnbendError):
        return Ended(path, "failed", str(found))
    partial_file = target.with_name(f".{target.name}.partial")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial_file.write_bytes(found.data)
        partial_file.replace(target)  # so that a signature is complete if it exists
    except OSError as error:
        with suppress(OSError):
            partial_file.unlink()
        return Ended(path, "failed", f"{target} cannot be written: {error.strerror}")
    return Ended(path, "new", result=str(target), warnings=found.warnings)
