"""Backups that a server makes by itself, at intervals, and keeps the newest of."""

from __future__ import annotations

import asyncio
import logging
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from unbend.api.metrics import Metrics
from unbend.errors import UnbendError
from unbend.library import Library

logger = logging.getLogger("unbend.backups")

_PREFIX: Final = "unbend-"
_ENDING: Final = ".db"
_RETRY_SECONDS: Final = 600.0


@dataclass(frozen=True)
class BackupPlan:
    """Where backups go, how many hours lie between two, and how many are kept."""

    folder: Path
    hours: float
    keep: int


class ScheduledBackups:
    """Makes backups from its start on; used within one event loop.

    A backup that is there from before counts, so that restarts make no more of them. One that fails is tried again
    after ten minutes, and the earlier ones stay.
    """

    def __init__(self, library: Library, plan: BackupPlan, metrics: Metrics) -> None:
        self._library = library
        self._plan = plan
        self._metrics = metrics
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin."""
        self._task = asyncio.create_task(self._run(), name="unbend backups")

    async def stop(self) -> None:
        """Begin no other; one that is being made is whole or not there."""
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
