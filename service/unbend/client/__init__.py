"""Calling a running service from Python."""

from unbend.client.client import AsyncClient, AsyncJob, Client, Job

__all__ = ["AsyncClient", "AsyncJob", "Client", "Job"]
