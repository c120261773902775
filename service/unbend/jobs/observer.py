"""Observers of jobs: the interface of metrics and traces."""

from __future__ import annotations

from collections.abc import Mapping
from contextvars import ContextVar
from typing import Final, Protocol

from unbend.library.records import JobRecord

CURRENT_JOB: Final[ContextVar[str | None]] = ContextVar("unbend job", default=None)
"""The id of the job that log lines of this task are about."""


class JobObserver(Protocol):
    """Observes jobs. Any thread may call it, so it must be thread-safe, and fast."""

    def submitted(self, job: JobRecord) -> None:
        """Observe a new job that is on disk and cannot have started, in the context of its request."""

    def begun(self, job: JobRecord) -> None:
        """Observe the start of an attempt at a job."""

    def ended(self, job: JobRecord) -> None:
        """Observe the end of a job in any state."""

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Observe the time of each stage of a computation, in seconds."""


class NoObserver:
    """Ignores everything; a base for observers of some events."""

    def submitted(self, job: JobRecord) -> None:
        """Ignore it."""

    def begun(self, job: JobRecord) -> None:
        """Ignore it."""

    def ended(self, job: JobRecord) -> None:
        """Ignore it."""

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Ignore it."""


class Observers:
    """Several observers as one."""

    def __init__(self, *observers: JobObserver) -> None:
        self._observers = observers

    def submitted(self, job: JobRecord) -> None:
        """Notify every observer."""
        for observer in self._observers:
            observer.submitted(job)

    def begun(self, job: JobRecord) -> None:
        """Notify every observer."""
        for observer in self._observers:
            observer.begun(job)

    def ended(self, job: JobRecord) -> None:
        """Notify every observer."""
        for observer in self._observers:
            observer.ended(job)

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Notify every observer."""
        for observer in self._observers:
            observer.computed(seconds)
