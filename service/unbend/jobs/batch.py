"""Signatures of many files at once, without a queue or a store: for the command line."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from pathlib import Path

from pebble import ProcessExpired, ProcessPool

from unbend.errors import MeshReadError, UnbendError, WorkerLostError
from unbend.jobs.worker import initialise
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.read import read_mesh
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature
from unbend.signature.signature import Signature
from unbend.threads import available_cores


def compute_paths(
    paths: Sequence[Path], parameters: Parameters, policy: MeshPolicy | None = None
) -> Iterator[Signature | UnbendError]:
    """Yield, for each path in order, its signature or the error that stands in its way.

    A process for every core; one that dies costs its own file only.
    """
    with ProcessPool(
        max_workers=min(available_cores(), max(1, len(paths))),
        initializer=initialise,
        initargs=(None,),
        context=multiprocessing.get_context("spawn"),
    ) as pool:
        futures = [pool.schedule(compute_path, args=(path, parameters, policy)) for path in paths]
        for path, future in zip(paths, futures, strict=True):
            try:
                yield future.result()
            except UnbendError as error:
                yield error
            except ProcessExpired:
                yield WorkerLostError("the process that computed it died")
            except OSError as error:
                yield MeshReadError(f"{path}: {error.strerror}")


def compute_path(path: Path, parameters: Parameters, policy: MeshPolicy | None) -> Signature:
    """Return the signature of the mesh at `path`."""
    return compute_signature(read_mesh(path, policy=policy), parameters, threads=1)
