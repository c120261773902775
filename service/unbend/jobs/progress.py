"""Progress from a worker process to its server, through one small file a job.

A file takes no lock, so a worker that is killed while it reports harms nobody; `os.replace` makes each report
whole or absent.
"""

from __future__ import annotations

import time
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


class StageClock:
    """Passes a worker's reports on, and measures how long each stage takes."""

    def __init__(self, file: ProgressFile) -> None:
        self._file = file
        self._seconds: dict[str, float] = {}
        self._stage: str | None = None
        self._since = time.perf_counter()

    def report(self, stage: str, share: float) -> None:
        """Report; a stage lasts until the first report of the next."""
        self._file.write(stage, share)
        if stage != self._stage:
            self._close(stage)

    def seconds(self) -> dict[str, float]:
        """End the last stage, and return the seconds that each took."""
        self._close(None)
        return dict(self._seconds)

    def _close(self, following: str | None) -> None:
        now = time.perf_counter()
        if self._stage is not None:
            self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._since
        self._stage, self._since = following, now
