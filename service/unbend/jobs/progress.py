"""Progress from a worker process to its server, through one small file a job.

A file takes no lock, so a worker that is killed while it reports harms nobody; `os.replace` makes each report
whole or absent.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Report:
    """Where a job stands."""

    stage: str
    share: float


class ProgressFile:
    """The place where one job's worker reports."""

    def __init__(self, folder: Path, job_id: str) -> None:
        self._path = folder / job_id

    def write(self, stage: str, share: float) -> None:
        """Report from the worker."""
        fresh = self._path.with_suffix(".new")
        fresh.write_text(f"{stage} {share:.4f}")
        fresh.replace(self._path)

    def read(self) -> Report | None:
        """Return the last report, None before the first."""
        try:
            stage, share = self._path.read_text().split()
        except FileNotFoundError:
            return None
        return Report(stage, float(share))

    def remove(self) -> None:
        """Forget the job's reports."""
        for path in (self._path, self._path.with_suffix(".new")):
            path.unlink(missing_ok=True)
