"""Backups over HTTP."""

from __future__ import annotations

import asyncio
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from fastapi import APIRouter
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask

from unbend.api.schema.headers import DISPOSITION
from unbend.api.schema.problems import problem_responses
from unbend.api.server.service import ServiceDependency
from unbend.errors import BusyError

router = APIRouter(prefix="/backups", tags=["library"])

MEDIA_TYPE: Final = "application/vnd.sqlite3"
_RETRY_SECONDS: Final = 30
_DESCRIBED: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "description": "The backup.",
        "content": {MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
        "headers": {"Content-Disposition": DISPOSITION["Content-Disposition"]},
    }
}


@router.post("", response_class=FileResponse, responses=_DESCRIBED | problem_responses(422, 507))
async def make_backup(service: ServiceDependency) -> FileResponse:
    """Make a backup of the whole library, check it, and send it; `unbend restore` restores it.

    The backup contains everything: files, jobs, and hashes of API keys. Only one backup is made at a time.
    """
    if service.backing_up.locked():
        raise BusyError("another backup is being made", _RETRY_SECONDS)
    async with service.backing_up:
        folder = tempfile.TemporaryDirectory(prefix="unbend-backup-")
        path = Path(folder.name) / "backup.db"
        try:
            await asyncio.to_thread(service.library.backup, path)
        except BaseException:
            folder.cleanup()
            raise
    name = f"unbend-{datetime.now(UTC):%Y%m%dT%H%M%S}Z.db"
    return FileResponse(path, media_type=MEDIA_TYPE, filename=name, background=BackgroundTask(folder.cleanup))
