"""From what went wrong in a worker to what a failed job says: a code, a sentence, advice, nothing internal."""

from __future__ import annotations

import logging

from unbend.errors import JobError, JobMemoryError, UnbendError

logger = logging.getLogger("unbend.jobs")


def typed_error(error: BaseException) -> UnbendError:
    """Return the error of our tree that `error` means."""
    if isinstance(error, UnbendError):
        return error
    if isinstance(error, MemoryError):
        return JobMemoryError("the mesh needs more memory than a job may use")
    logger.error("a job failed with an unexpected error", exc_info=error)
    return JobError("the job failed for a reason that is ours, not the mesh's")


def describe(error: UnbendError) -> dict[str, object]:
    """Return an error as a failed job carries it."""
    return {"code": error.code, "message": str(error), "advice": error.advice}
