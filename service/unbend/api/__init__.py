"""The HTTP API: FastAPI over the job runner and the library."""

from unbend.api.app import create_app
from unbend.api.server.settings import Settings

__all__ = ["Settings", "create_app"]
