"""Progress reports of a job from its worker, and the time of each stage."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from types import TracebackType
from typing import Final, Self

from unbend.jobs.process import send_message
from unbend.progress import Progress, Stage

_NEW_STAGE_SECONDS: Final = 0.02
"""Shortest time between two reports of different stages. A stage that ends sooner is not reported."""
_SAME_STAGE_SECONDS: Final = 0.05
"""Shortest time between two reports of one stage. More reports would only cost the server time."""
_HEARTBEAT_SECONDS: Final = 1.0
"""Time without a report after which the last report is sent again."""


class ProgressReporter:
    """Sends a worker's progress to the server, and measures the time of each stage.

    While a stage reports nothing, the last report is sent again every second with the time so far, so that a client can
    distinguish a long stage from a lost worker.
    """

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._last: Progress | None = None
        self._stage_began = self._sent = time.perf_counter()
        self._began = self._stage_began
        self._lock = threading.Lock()
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        threading.Thread(target=self._send_heartbeats, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._lock:  # no report may follow: the process then runs another job
            self._ended.set()

    def report(self, progress: Progress) -> None:
        """Record progress, and send it unless the last report is recent. A new stage ends the stage before."""
        now = time.perf_counter()
        is_new = self._last is None or progress.stage != self._last.stage
        if is_new:
            self._end_stage(now)
        self._last = progress
        if now - self._sent >= (_NEW_STAGE_SECONDS if is_new else _SAME_STAGE_SECONDS):
            self.send()
            self._sent = now

    def send(self) -> None:
        """Send the latest progress."""
        with self._lock:
            if self._last and not self._ended.is_set():
                seconds = round(time.perf_counter() - self._began, 1)
                send_message(replace(self._last, detail={**self._last.detail, "seconds": seconds}))

    def seconds(self) -> dict[str, float]:
        """End the last stage, and return the seconds of each stage."""
        self._end_stage(time.perf_counter())
        return dict(self._seconds)

    def _send_heartbeats(self) -> None:
        while not self._ended.wait(_HEARTBEAT_SECONDS):
            if time.perf_counter() - self._sent >= _HEARTBEAT_SECONDS:
                self.send()

    def _end_stage(self, now: float) -> None:
        if self._last is not None:
            stage: Stage = self._last.stage
            self._seconds[stage] = self._seconds.get(stage, 0.0) + now - self._stage_began
        self._stage_began = now
