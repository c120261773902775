"""The sweeps of an object store that a server makes: deletions and dead writes each hour, a comparison each day."""

from __future__ import annotations

import asyncio
import logging
from typing import Final

from unbend.api.server.background import Background
from unbend.errors import UnbendError
from unbend.library import Library
from unbend.library.sweeping import sweep, tidy

logger = logging.getLogger("unbend.objects")

_HOUR: Final = 3600.0
_HOURS: Final = 24
_SHOWN: Final = 5


class ObjectSweeps(Background):
    """Sweeps the object store of a library: at once what an earlier server left, and from then on every hour.

    The server deletes only objects that the database names. It reports the others, and leaves them to `unbend sweep
    --delete`, because they may belong to another library, or to the state before a restored backup.
    """

    name = "sweeps"

    def __init__(self, library: Library) -> None:
        super().__init__()
        self._library = library

    async def _run(self) -> None:
        hours = 0
        while True:
            try:
                await asyncio.to_thread(self._compare if hours % _HOURS == 1 else self._tidy)
            except UnbendError as error:
                logger.warning("the object store could not be swept: %s", error)
            await asyncio.sleep(_HOUR)
            hours += 1

    def _tidy(self) -> None:
        tidy(self._library)

    def _compare(self) -> None:
        found = sweep(self._library)
        logger.info("the object store has %d objects, %d bytes", found.objects, found.size)
        if found.orphans:
            logger.warning("%d objects have no mesh: see `unbend sweep`", len(found.orphans))
        if found.missing:
            shown = ", ".join(found.missing[:_SHOWN])
            logger.error("%d meshes have no object, such as %s: see `unbend sweep`", len(found.missing), shown)
