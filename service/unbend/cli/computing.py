"""Signatures of many files, on all cores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from unbend.cli.folder import LabelledFile
from unbend.cli.options import progress, warn
from unbend.errors import UnbendError

if TYPE_CHECKING:
    from unbend.signature.parameters import Parameters
    from unbend.signature.signature import Signature


@dataclass(frozen=True)
class Computed:
    """A file, its class, and its signature or why there is none."""

    file: LabelledFile
    signature: Signature | None
    error: str = ""


def compute_files(files: Sequence[LabelledFile], parameters: Parameters) -> list[Computed]:
    """Return the signatures of `files` in their order; a file that fails is reported and does not stop the rest."""
    with progress(_computed(files, parameters), "computing signatures", len(files)) as bar:
        results = list(bar)
    for result in results:
        if result.signature is None:
            warn(f"{result.file.path}: {result.error}")
    return results


def _computed(files: Sequence[LabelledFile], parameters: Parameters) -> Iterator[Computed]:
    from unbend.jobs.batch import compute_paths  # noqa: PLC0415

    for file, outcome in zip(files, compute_paths([file.path for file in files], parameters), strict=True):
        if isinstance(outcome, UnbendError):
            yield Computed(file, None, str(outcome))
        else:
            yield Computed(file, outcome)
