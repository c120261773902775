"""Running of a library's jobs: a dispatcher, a pool of worker processes, progress and cancellation."""

from unbend.jobs.limits import JobLimits
from unbend.jobs.observer import JobObserver
from unbend.jobs.runner import JobRunner

__all__ = ["JobLimits", "JobObserver", "JobRunner"]
