"""Errors of failed jobs as a code, a message and advice, without internal details."""

from __future__ import annotations

import logging

from unbend.errors import JobError, JobMemoryError, UnbendError

logger = logging.getLogger("unbend.jobs")


def typed_error(error: BaseException) -> UnbendError:
    """Return an error of a worker as an UnbendError; log an unexpected error."""
    if isinstance(error, UnbendError):
        return error
    if isinstance(error, MemoryError):
        return JobMemoryError("the mesh needs more memory than a job may use")
    logger.error("a job failed with an unexpected error", exc_info=error)
    return JobError("the job failed because of a bug in unbend, not because of the mesh")


def describe(error: UnbendError) -> dict[str, object]:
    """Return the form in which a failed job stores an error."""
    return {"code": error.code, "message": str(error), "advice": error.advice}
