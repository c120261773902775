"""Backups that a server makes at intervals, of which it keeps the newest."""

from __future__ import annotations

import asyncio
import logging
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from unbend.api.server.metrics import Metrics
from unbend.errors import UnbendError
from unbend.library import Library

logger = logging.getLogger("unbend.backups")

_PREFIX: Final = "unbend-"
_ENDING: Final = ".db"
_RETRY_SECONDS: Final = 600.0


@dataclass(frozen=True)
class BackupPlan:
    """The folder of backups, the hours between two, and the number to keep."""

    folder: Path
    hours: float
    keep: int


class ScheduledBackups:
    """Makes backups while the server runs; used within one event loop.

    Existing backups count, so that restarts do not add more. A failed backup is retried after ten minutes, and earlier
    ones stay.
    """

    def __init__(self, library: Library, plan: BackupPlan, metrics: Metrics) -> None:
        self._library = library
        self._plan = plan
        self._metrics = metrics
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Start making backups."""
        self._task = asyncio.create_task(self._run(), name="unbend backups")

    async def stop(self) -> None:
        """Make no more backups; one under way is completed or deleted."""
        if self._task:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            made = backups_in(self._plan.folder)
            last = made[-1].stat().st_mtime if made else 0.0
            self._metrics.backed_up(last)
            await asyncio.sleep(max(0.0, last + 3600.0 * self._plan.hours - time.time()))
            try:
                await asyncio.to_thread(self._make)
            except (UnbendError, OSError) as error:
                logger.error("a backup could not be made: %s", error)  # noqa: TRY400
                self._metrics.backup_failed()
                await asyncio.sleep(_RETRY_SECONDS)

    def _make(self) -> None:
        name = f"{_PREFIX}{datetime.now(UTC):%Y%m%dT%H%M%S}Z{_ENDING}"
        made = self._library.backup(self._plan.folder / name)
        logger.info("backup %s: %d shapes, %d bytes", name, made.shapes, made.size)
        for old in backups_in(self._plan.folder)[: -self._plan.keep]:
            old.unlink(missing_ok=True)


def backups_in(folder: Path) -> list[Path]:
    """Return the backups of a folder, the oldest first."""
    return sorted(folder.glob(f"{_PREFIX}*{_ENDING}"))
