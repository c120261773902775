"""Observers of jobs, such as metrics and traces."""

from __future__ import annotations

from collections.abc import Mapping
from contextvars import ContextVar
from typing import Final, Protocol

from unbend.library.records import JobRecord

CURRENT_JOB: Final[ContextVar[str | None]] = ContextVar("unbend job", default=None)
"""The id of the job of the present task, for its log lines."""


class JobObserver(Protocol):
    """An observer of jobs. Any thread may call its methods, so they must be thread-safe, and fast."""

    def submitted(self, job: JobRecord) -> None:
        """Observe a new job that is on disk and cannot have started, in the context of its request."""

    def begun(self, job: JobRecord) -> None:
        """Observe the start of an attempt at a job."""

    def ended(self, job: JobRecord) -> None:
        """Observe the end of a job in any state."""

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Observe the time of each stage of a computation, in seconds."""


class NoObserver:
    """An observer that ignores every event; a base class of observers of some events."""

    def submitted(self, job: JobRecord) -> None:
        """Ignore the event."""

    def begun(self, job: JobRecord) -> None:
        """Ignore the event."""

    def ended(self, job: JobRecord) -> None:
        """Ignore the event."""

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Ignore the event."""


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
