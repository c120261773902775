"""Errors of failed jobs: a code, a message and advice, without internals."""

from __future__ import annotations

import logging

from unbend.errors import JobError, JobMemoryError, UnbendError

logger = logging.getLogger("unbend.jobs")


def typed_error(error: BaseException) -> UnbendError:
    """Return the UnbendError that stands for any error of a worker."""
    if isinstance(error, UnbendError):
        return error
    if isinstance(error, MemoryError):
        return JobMemoryError("the mesh needs more memory than a job may use")
    logger.error("a job failed with an unexpected error", exc_info=error)
    return JobError("the job failed because of a fault in unbend, not in the mesh")


def describe(error: UnbendError) -> dict[str, object]:
    """Return the form in which a failed job stores an error."""
    return {"code": error.code, "message": str(error), "advice": error.advice}
