"""Python clients of a running service."""

from unbend.client.async_client import AsyncClient, AsyncJob
from unbend.client.client import Client
from unbend.client.sync_client import Job

__all__ = ["AsyncClient", "AsyncJob", "Client", "Job"]
