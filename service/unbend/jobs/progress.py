"""Progress of a job, from the worker that computes it to whoever asks."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Final, Self

from unbend.jobs.process import tell

_SHORT_SECONDS: Final = 0.02
_QUIET_SECONDS: Final = 0.05
"""Between two reports of a stage; more would only be work for the server."""
_BEAT_SECONDS: Final = 1.0
"""After which a stage that reports nothing is said to go on."""


@dataclass(frozen=True)
class Report:
    """Where a job stands."""

    stage: str
    share: float
    detail: Mapping[str, float] = field(default_factory=dict)
    """What the stage can tell: which sample of how many, which iteration and its stress."""


class StageClock:
    """Passes a worker's reports on, and measures how long each stage takes.

    A stage that cannot say how far it is still says, each second, that it goes on, and for how long it has: a job that
    computes is told from one that stands still.
    """

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._last: Report | None = None
        self._since = self._told = time.perf_counter()
        self._begun = self._since
        self._lock = threading.Lock()
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        threading.Thread(target=self._beat, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._lock:  # what is told from now on is somebody else's
            self._ended.set()

    def begin(self, stage: str) -> None:
        """Report a stage of which no more can be told, before anything is computed."""
        self.report(stage, 0.0)

    def report(self, stage: str, share: float) -> None:
        """Report; a stage lasts until the first report of the next."""
        now = time.perf_counter()
        is_new = self._last is None or stage != self._last.stage
        if is_new:
            self._close(now)
        self._last = Report(str(stage), share, getattr(stage, "detail", {}))
        if now - self._told >= (_SHORT_SECONDS if is_new else _QUIET_SECONDS):
            self.tell()
            self._told = now

    def tell(self) -> None:
        """Pass on where the work stands."""
        with self._lock:
            if self._last and not self._ended.is_set():
                seconds = round(time.perf_counter() - self._begun, 1)
                tell(replace(self._last, detail={**self._last.detail, "seconds": seconds}))

    def _beat(self) -> None:
        while not self._ended.wait(_BEAT_SECONDS):
            if time.perf_counter() - self._told >= _BEAT_SECONDS:
                self.tell()

    def seconds(self) -> dict[str, float]:
        """End the last stage, and return the seconds that each took."""
        self._close(time.perf_counter())
        return dict(self._seconds)

    def _close(self, now: float) -> None:
        if self._last is not None:
            self._seconds[self._last.stage] = self._seconds.get(self._last.stage, 0.0) + now - self._since
        self._since = now
