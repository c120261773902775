"""The service's settings, each an environment variable with the prefix UNBEND_."""

from __future__ import annotations

import re
from typing import Final

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from unbend.api.connections import ConnectionLimits
from unbend.api.limits import BodyLimits
from unbend.api.logs import LogFormat
from unbend.jobs import JobLimits
from unbend.threads import available_cores

_ORIGIN: Final = re.compile(r"https?://[^\s/?#@*]+")


class Settings(BaseSettings):
    """What a server is started with; a wrong value is refused with its name."""

    model_config = SettingsConfigDict(env_prefix="UNBEND_", frozen=True, extra="forbid")

    library: str = Field("unbend.db", description="Path of an SQLite file, or an SQLAlchemy URL.")
    workers: int = Field(
        default_factory=available_cores, ge=1, le=256, description="Processes that compute; one for each core."
    )
    max_upload_mb: int = Field(64, ge=1, le=4096, description="Most megabytes that a request may have.")
    max_arriving_mb: int = Field(1024, ge=1, description="Most megabytes of all requests in hand together.")
    transfer_seconds: float = Field(900.0, gt=0, description="Seconds that a request or an answer may take.")
    stall_seconds: float = Field(30.0, gt=0, description="Seconds that either may stand still.")
    head_seconds: float = Field(15.0, gt=0, description="Seconds that the head of a request may take.")
    max_connections: int = Field(10_000, ge=8, description="Most connections; with more, idle ones are closed.")
    max_waiting: int = Field(1000, ge=1, description="Most long polls and streams of events at a time.")
    max_queued: int = Field(10_000, ge=1, description="Jobs that may wait before uploads are answered 429.")
    job_seconds: float = Field(600.0, gt=0, description="Seconds after which a job is stopped.")
    job_memory_mb: int = Field(8192, ge=1024, description="Megabytes of address space that a worker may use.")
    drain_seconds: float = Field(20.0, ge=0, description="Seconds that running jobs are given when the server stops.")
    log_format: LogFormat = Field("text", description="Lines of text, or one JSON object a line.")

    open: bool = Field(False, description="Serve callers without a key at any address while there are no keys.")
    requests_per_minute: int = Field(0, ge=0, description="Calls of one key, or address without; 0 for no limit.")
    cors_origins: str = Field("", description="Web sites whose pages may call: origins, with commas between them.")

    @field_validator("cors_origins")
    @classmethod
    def _check_origins(cls, value: str) -> str:
        for origin in _listed(value):
            if origin != "*" and not _ORIGIN.fullmatch(origin):
                raise ValueError(f"{origin!r} is not an origin such as https://example.org")
        return value

    @property
    def origins(self) -> list[str]:
        """The origins among the settings."""
        return _listed(self.cors_origins)

    @property
    def body_limits(self) -> BodyLimits:
        """The limits of requests' bodies among the settings."""
        return BodyLimits(
            each=self.max_upload_mb * 2**20,
            together=self.max_arriving_mb * 2**20,
            stall_seconds=self.stall_seconds,
            seconds=self.transfer_seconds,
        )

    @property
    def connection_limits(self) -> ConnectionLimits:
        """The limits of connections among the settings."""
        return ConnectionLimits(
            head_seconds=self.head_seconds,
            stall_seconds=self.stall_seconds,
            transfer_seconds=self.transfer_seconds,
            connections=self.max_connections,
        )

    @property
    def limits(self) -> JobLimits:
        """The limits of jobs among the settings."""
        return JobLimits(
            seconds=self.job_seconds,
            memory_mb=self.job_memory_mb,
            queued=self.max_queued,
            drain_seconds=self.drain_seconds,
        )


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]
