"""Jobs: a durable queue worked off by a pool of processes, with progress and cancellation."""

from unbend.jobs.limits import JobLimits
from unbend.jobs.observer import JobObserver
from unbend.jobs.runner import JobRunner, Upload

__all__ = ["JobLimits", "JobObserver", "JobRunner", "Upload"]
