"""Backups that a server makes at intervals. The server keeps only the newest backups."""

from __future__ import annotations

import asyncio
import logging
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from unbend.api.server.background import Background
from unbend.api.server.metrics import Metrics
from unbend.errors import UnbendError
from unbend.library import Library

logger = logging.getLogger("unbend.backups")

_PREFIX: Final = "unbend-"
_ENDING: Final = ".db"
_RETRY_SECONDS: Final = 600.0


@dataclass(frozen=True)
class BackupPlan:
    """The folder of backups, the hours between two backups, and the number of backups to keep."""

    folder: Path
    hours: float
    keep: int


class ScheduledBackups(Background):
    """Makes backups while the server runs; used within one event loop.

    The next backup is due `plan.hours` after the newest in the folder, so that a restart makes no additional backup. A
    failed backup is retried after ten minutes, and no earlier backup is deleted.
    """

    name = "backups"

    def __init__(self, library: Library, plan: BackupPlan, metrics: Metrics) -> None:
        super().__init__()
        self._library = library
        self._plan = plan
        self._metrics = metrics

    async def _run(self) -> None:
        while True:
            try:
                await asyncio.sleep(self._seconds_to_next())
                await asyncio.to_thread(self._make)
            except (UnbendError, OSError) as error:
                logger.error("a backup could not be made: %s", error)  # noqa: TRY400
                self._metrics.backup_failed()
                await asyncio.sleep(_RETRY_SECONDS)

    def _seconds_to_next(self) -> float:
        """Return the seconds until the next backup is due, and record the time of the last backup."""
        made = backups_in(self._plan.folder)
        last = made[-1].stat().st_mtime if made else 0.0
        self._metrics.backed_up(last)
        return max(0.0, last + 3600.0 * self._plan.hours - time.time())

    def _make(self) -> None:
        name = f"{_PREFIX}{datetime.now(UTC):%Y%m%dT%H%M%S}Z{_ENDING}"
        made = self._library.backup(self._plan.folder / name)
        logger.info("backup %s: %d shapes, %d bytes", name, made.shapes, made.size)
        for old in backups_in(self._plan.folder)[: -self._plan.keep]:
            old.unlink(missing_ok=True)


def backups_in(folder: Path) -> list[Path]:
    """Return the backups of a folder, the oldest first."""
    return sorted(folder.glob(f"{_PREFIX}*{_ENDING}"))
