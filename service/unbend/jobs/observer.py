"""What the job runner tells to whoever keeps figures of it."""

from __future__ import annotations

from collections.abc import Mapping
from contextvars import ContextVar
from typing import Final, Protocol

from unbend.library.records import JobRecord

STAGES: Final = ("starting", "reading", "repairing", "sampling", "geodesics", "embedding", "describing")
"""What a running job is at, in this order."""

CURRENT_JOB: Final[ContextVar[str | None]] = ContextVar("unbend job", default=None)
"""The job that a line of the log is about."""


class JobObserver(Protocol):
    """Keeps figures; called from any thread, so it must be safe there, and quick."""

    def submitted(self, job: JobRecord) -> None:
        """Take note of a new job that is on disk, in the context of who submits it and before anybody can begin it."""

    def begun(self, job: JobRecord) -> None:
        """Take note of an attempt at a job."""

    def ended(self, job: JobRecord) -> None:
        """Take note of a job that has just ended, however it did."""

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Take note of how long each stage of a computation took."""


class NoObserver:
    """Keeps nothing; those who keep some of it begin here."""

    def submitted(self, job: JobRecord) -> None:
        """Forget it."""

    def begun(self, job: JobRecord) -> None:
        """Forget it."""

    def ended(self, job: JobRecord) -> None:
        """Forget it."""

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Forget it."""


class Observers:
    """Several as one."""

    def __init__(self, *observers: JobObserver) -> None:
        self._observers = observers

    def submitted(self, job: JobRecord) -> None:
        """Tell all."""
        for observer in self._observers:
            observer.submitted(job)

    def begun(self, job: JobRecord) -> None:
        """Tell all."""
        for observer in self._observers:
            observer.begun(job)

    def ended(self, job: JobRecord) -> None:
        """Tell all."""
        for observer in self._observers:
            observer.ended(job)

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Tell all."""
        for observer in self._observers:
            observer.computed(seconds)
