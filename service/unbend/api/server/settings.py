"""The settings of a server: environment variables with the prefix UNBEND_, or keys of a file (see `configuration`)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from ipaddress import ip_network
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError
from pydantic_settings import BaseSettings, SettingsConfigDict

from unbend.api.server.connections import ConnectionLimits
from unbend.api.server.logs import LogFormat
from unbend.api.server.scheduled_backups import BackupPlan
from unbend.api.server.webhooks import WebhookPlan, signing_key
from unbend.jobs.limits import JobLimits
from unbend.library.search import SearchChoice
from unbend.library.storage.database import is_shared
from unbend.mesh.limits import MeshLimits
from unbend.names import DEFAULT_LIBRARY
from unbend.threads import available_cores

ENVIRONMENT_PREFIX: Final = "UNBEND_"

_ORIGIN: Final = re.compile(r"(https?)://([a-z0-9._-]+|\[[0-9a-f:.]+\])(?::([1-9][0-9]{0,4}))?")
_ROOT: Final = re.compile(r"(/[A-Za-z0-9._~-]+)+")
_OWN_PATHS: Final = (["v1"], ["assets"], ["docs"], ["redoc"], ["openapi.json"], ["docs-assets"])
_STANDARD_PORTS: Final = {"http": "80", "https": "443"}
_MOST_WORKERS: Final = 256
_MANY: Final = 10**9
_ROWS_MB: Final = 16
_SHORTEST_SECRET: Final = 16
_ADDRESSES_MB: Final = 2**27  # the address space of a 64-bit process


@dataclass(frozen=True)
class BodyLimits:
    """Limits on the bodies of requests."""

    each: int
    """Maximum size of a body with a file, in bytes."""
    json: int
    """Maximum size of any other body, in bytes. Such a body is parsed on the event loop."""
    together: int
    """Maximum number of received bytes of all requests in progress together."""
    stall_seconds: float
    """Longest time without a received byte."""
    seconds: float
    """Longest time of a whole body."""


class Settings(BaseSettings):
    """The settings of a server."""

    model_config = SettingsConfigDict(env_prefix=ENVIRONMENT_PREFIX, frozen=True, extra="forbid")

    library: str = Field(DEFAULT_LIBRARY, min_length=1, description="Path of an SQLite file, or an SQLAlchemy URL.")
    migrate: bool = Field(True, description="Migrate a library of an older schema; otherwise refuse it.")
    objects: str = Field(
        "", description="Object store for the files of meshes, such as s3://bucket/prefix; the library if empty."
    )
    workers: int = Field(
        default_factory=lambda: min(available_cores(), _MOST_WORKERS),
        ge=0,
        le=_MOST_WORKERS,
        description="Worker processes; one for each core by default. 0 if `unbend worker` runs the jobs elsewhere.",
    )
    search: SearchChoice = Field(
        "auto",
        description="Who searches: an index in memory, or PostgreSQL with pgvector. By default the index in memory, "
        "until it becomes too large.",
    )
    local_signatures: bool = Field(
        True, description="Compute the local signatures of uploads, by which pieces are recognised."
    )
    max_upload_mb: int = Field(64, ge=1, le=4096, description="Most megabytes of a request with a file.")
    max_json_kb: int = Field(
        64,
        ge=1,
        le=_MANY,
        description="Most kilobytes of a request without a file, because its parsing delays other requests.",
    )
    max_arriving_mb: int = Field(
        1024, ge=1, le=_MANY, description="Most received megabytes of all requests in progress."
    )
    max_answering_mb: int = Field(
        256, ge=1, le=_MANY, description="Most megabytes of unread responses, except uploaded files."
    )
    transfer_seconds: float = Field(
        900.0, gt=0, allow_inf_nan=False, description="Most seconds for the transfer of a request or a response."
    )
    stall_seconds: float = Field(
        30.0, gt=0, allow_inf_nan=False, description="Most seconds without progress of a transfer."
    )
    head_seconds: float = Field(15.0, gt=0, allow_inf_nan=False, description="Most seconds for the head of a request.")
    max_connections: int = Field(
        10_000, ge=8, le=_MANY, description="Most connections; idle connections are evicted first."
    )
    max_waiting: int = Field(1000, ge=1, le=_MANY, description="Most long polls and event streams at a time.")
    max_vertices: int = Field(2_000_000, ge=4, le=_MANY, description="Most vertices of a mesh file.")
    max_faces: int = Field(4_000_000, ge=1, le=_MANY, description="Most triangles of a mesh file.")
    max_queued: int = Field(10_000, ge=1, le=_MANY, description="Most queued jobs; further uploads get 429.")
    job_seconds: float = Field(600.0, gt=0, allow_inf_nan=False, description="Seconds after which a job is stopped.")
    call_seconds: float = Field(
        60.0, gt=0, allow_inf_nan=False, description="Most seconds of a computation without a job."
    )
    job_memory_mb: int = Field(
        8192, ge=1024, le=_ADDRESSES_MB, description="Most megabytes of address space of a worker."
    )
    backup_folder: str = Field("", description="Folder for scheduled backups; none if empty.")
    backup_hours: float = Field(
        24.0, gt=0, le=_MANY, allow_inf_nan=False, description="Hours between two scheduled backups."
    )
    backup_keep: int = Field(7, ge=1, le=_MANY, description="Number of newest backups to keep.")
    job_history: int = Field(100_000, ge=0, le=_MANY, description="Number of newest ended jobs to keep.")
    job_days: float = Field(
        0.0, ge=0, le=_MANY, allow_inf_nan=False, description="Days to keep an ended job; 0 for no limit."
    )
    reserve_mb: int = Field(
        0,
        ge=0,
        le=_MANY,
        description="Reserved megabytes of the library's disk, for removals; 0 for max_upload_mb + 16.",
    )
    drain_seconds: float = Field(
        20.0, ge=0, allow_inf_nan=False, description="Most seconds for which a stopping server waits for running jobs."
    )
    log_format: LogFormat = Field(
        "text", description="Format of the log: lines of text, or one JSON object in each line."
    )
    traces: str = Field("", description="URL of an OTLP collector for traces; none if empty.")

    open: bool = Field(
        False, description="Serve callers at any address without a key, as long as the library has no keys."
    )
    requests_per_minute: int = Field(
        0, ge=0, le=_MANY, description="Most requests of a key, or of an address without key; 0 for no limit."
    )
    webhook_hosts: str = Field("", description="Hosts that webhooks may call, separated by commas; none if empty.")
    webhook_secret: str = Field("", description="Secret that signs webhooks, of at least 16 characters.")
    root_path: str = Field("", description="Path of the service behind a proxy, such as /shapes.")
    allowed_hosts: str = Field(
        "",
        description="Host names of the service for callers without a key; * for all. IP addresses are always allowed.",
    )
    trusted_proxies: str = Field(
        "", description="Addresses of proxies whose X-Forwarded-For is trusted, separated by commas; * for all."
    )
    cors_origins: str = Field(
        "", description="Origins of websites whose pages may call the service, separated by commas."
    )

    @field_validator("workers")
    @classmethod
    def _check_workers(cls, value: int, info: ValidationInfo) -> int:
        if value == 0 and not is_shared(info.data.get("library", DEFAULT_LIBRARY)):
            reason = "should be at least 1, because no other process runs the jobs of a library in SQLite"
            raise PydanticCustomError("contradiction", reason)
        return value

    @field_validator("search")
    @classmethod
    def _check_search(cls, value: SearchChoice, info: ValidationInfo) -> SearchChoice:
        if value == "database" and not is_shared(info.data.get("library", DEFAULT_LIBRARY)):
            raise ValueError("should be auto or memory, because only PostgreSQL searches")
        return value

    @field_validator("job_memory_mb")
    @classmethod
    def _check_memory(cls, value: int, info: ValidationInfo) -> int:
        if value <= info.data.get("max_upload_mb", 0):
            setting = "max_upload_mb"
            reason = "should be more than {setting}, because a job has its whole upload in memory"
            raise PydanticCustomError("contradiction", reason, {"setting": setting})
        return value

    @field_validator("traces")
    @classmethod
    def _check_traces(cls, value: str) -> str:
        if value and not _is_http_url(value):
            raise ValueError("should be an address such as http://localhost:4318, or empty")
        return value

    @field_validator("cors_origins")
    @classmethod
    def _check_origins(cls, value: str) -> str:
        origins = _listed(value)
        if "*" in origins and len(origins) > 1:
            raise ValueError("'*' means all websites, so do not name others")
        for origin in origins:
            if origin != "*" and not _is_origin(origin):
                raise ValueError(f"{origin!r} is not an origin as browsers send it, such as https://example.org")
        return value

    @property
    def origins(self) -> list[str]:
        """The allowed origins."""
        return _listed(self.cors_origins)

    @field_validator("root_path")
    @classmethod
    def _check_root(cls, value: str) -> str:
        if value and not _ROOT.fullmatch(value):
            raise ValueError("should be a path such as /shapes, without a slash at its end")
        if value.split("/")[1:2] in _OWN_PATHS:
            raise ValueError(f"must not begin like a path of the service itself: {value!r}")
        return value

    @field_validator("trusted_proxies")
    @classmethod
    def _check_proxies(cls, value: str) -> str:
        for address in _listed(value):
            if address != "*":
                ip_network(address, strict=False)
        return value

    @property
    def hosts(self) -> list[str]:
        """The allowed host names, in lower case."""
        return [name.lower() for name in _listed(self.allowed_hosts)]

    @field_validator("backup_folder")
    @classmethod
    def _check_folder(cls, value: str, info: ValidationInfo) -> str:
        if value and is_shared(info.data.get("library", DEFAULT_LIBRARY)):
            raise ValueError("should be empty, because pg_dump makes the backups of a library in PostgreSQL")
        if value and not Path(value).is_dir():
            raise ValueError(f"there is no folder {value}")
        return value

    @field_validator("webhook_secret")
    @classmethod
    def _check_secret(cls, value: str, info: ValidationInfo) -> str:
        if info.data.get("webhook_hosts") and len(value) < _SHORTEST_SECRET:
            raise ValueError(f"should have at least {_SHORTEST_SECRET} characters if webhook_hosts is set")
        signing_key(value)
        return value

    @property
    def webhook_plan(self) -> WebhookPlan | None:
        """The allowed hosts and the secret of webhooks; None if webhooks are off."""
        hosts = [name.lower() for name in _listed(self.webhook_hosts)]
        return WebhookPlan(hosts, self.webhook_secret) if hosts else None

    @property
    def backup_plan(self) -> BackupPlan | None:
        """The plan of scheduled backups; None if they are off."""
        if not self.backup_folder:
            return None
        return BackupPlan(Path(self.backup_folder), self.backup_hours, self.backup_keep)

    @property
    def proxies(self) -> list[str]:
        """The addresses and networks of trusted proxies."""
        return _listed(self.trusted_proxies)

    @property
    def reserve_bytes(self) -> int:
        """Reserved bytes of the library's disk: removing a shape needs space, as SQLite overwrites deleted data."""
        return (self.reserve_mb or self.max_upload_mb + _ROWS_MB) * 2**20

    @property
    def body_limits(self) -> BodyLimits:
        """The limits on bodies."""
        return BodyLimits(
            each=self.max_upload_mb * 2**20,
            json=self.max_json_kb * 2**10,
            together=self.max_arriving_mb * 2**20,
            stall_seconds=self.stall_seconds,
            seconds=self.transfer_seconds,
        )

    @property
    def connection_limits(self) -> ConnectionLimits:
        """The limits on connections."""
        return ConnectionLimits(
            head_seconds=self.head_seconds,
            stall_seconds=self.stall_seconds,
            transfer_seconds=self.transfer_seconds,
            connections=self.max_connections,
        )

    @property
    def limits(self) -> JobLimits:
        """The limits on jobs."""
        return JobLimits(
            seconds=self.job_seconds,
            memory_mb=self.job_memory_mb,
            queued=self.max_queued,
            drain_seconds=self.drain_seconds,
            call_seconds=self.call_seconds,
            history=self.job_history,
            history_days=self.job_days,
            mesh=MeshLimits(self.max_vertices, self.max_faces),
        )


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _is_origin(text: str) -> bool:
    """Return whether text is an origin as browsers send it: lower case, without a path and without a default port."""
    found = _ORIGIN.fullmatch(text)
    return found is not None and found[3] != _STANDARD_PORTS[found[1]] and int(found[3] or 0) < 2**16


def _is_http_url(text: str) -> bool:
    try:
        url = urlsplit(text)
        return url.scheme in {"http", "https"} and bool(url.hostname) and url.port != 0 and not url.fragment
    except ValueError:
        return False
