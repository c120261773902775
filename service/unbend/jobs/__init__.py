"""Running of a library's jobs: a dispatcher, a pool of worker processes, progress and cancellation."""
