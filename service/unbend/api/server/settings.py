"""The settings of a server: environment variables with the prefix UNBEND_, or keys of a file (`configuration`)."""

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
from unbend.api.server.webhooks import WebhookPlan
from unbend.jobs import JobLimits
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
    """Bytes of a body with a file."""
    json: int
    """Bytes of any other body, which is parsed on the event loop."""
    together: int
    """Received bytes of all requests without a response yet."""
    stall_seconds: float
    """Longest time without a byte."""
    seconds: float
    """Longest time of a whole body."""


class Settings(BaseSettings):
    """The settings of a server; an invalid value is refused with its name."""

    model_config = SettingsConfigDict(env_prefix=ENVIRONMENT_PREFIX, frozen=True, extra="forbid")

    library: str = Field(DEFAULT_LIBRARY, min_length=1, description="Path of an SQLite file, or an SQLAlchemy URL.")
    workers: int = Field(
        default_factory=lambda: min(available_cores(), _MOST_WORKERS),
        ge=1,
        le=_MOST_WORKERS,
        description="Processes that compute; one for each core.",
    )
    max_upload_mb: int = Field(64, ge=1, le=4096, description="Most megabytes that a request may have.")
    max_json_kb: int = Field(
        64, ge=1, le=_MANY, description="Most kilobytes of a request without a file: it is parsed while others wait."
    )
    max_arriving_mb: int = Field(1024, ge=1, le=_MANY, description="Most megabytes of all requests in hand together.")
    max_answering_mb: int = Field(
        256, ge=1, le=_MANY, description="Most megabytes of answers, but files from the store, that wait to be taken."
    )
    transfer_seconds: float = Field(
        900.0, gt=0, allow_inf_nan=False, description="Seconds that a request or an answer may take."
    )
    stall_seconds: float = Field(30.0, gt=0, allow_inf_nan=False, description="Seconds that either may stand still.")
    head_seconds: float = Field(
        15.0, gt=0, allow_inf_nan=False, description="Seconds that the head of a request may take."
    )
    max_connections: int = Field(10_000, ge=8, le=_MANY, description="Most connections; idle ones are closed first.")
    max_waiting: int = Field(1000, ge=1, le=_MANY, description="Most long polls and streams of events at a time.")
    max_vertices: int = Field(2_000_000, ge=4, le=_MANY, description="Most vertices that a mesh file may hold.")
    max_faces: int = Field(4_000_000, ge=1, le=_MANY, description="Most triangles that a mesh file may hold.")
    max_queued: int = Field(10_000, ge=1, le=_MANY, description="Jobs that may wait before uploads are answered 429.")
    job_seconds: float = Field(600.0, gt=0, allow_inf_nan=False, description="Seconds after which a job is stopped.")
    call_seconds: float = Field(
        60.0, gt=0, allow_inf_nan=False, description="Seconds that what is computed while somebody waits may take."
    )
    job_memory_mb: int = Field(
        8192, ge=1024, le=_ADDRESSES_MB, description="Megabytes of address space that a worker may use."
    )
    backup_folder: str = Field("", description="Folder that backups are made in from time to time; none without.")
    backup_hours: float = Field(24.0, gt=0, le=_MANY, allow_inf_nan=False, description="Hours between two backups.")
    backup_keep: int = Field(7, ge=1, le=_MANY, description="Backups that are kept; the newest.")
    job_history: int = Field(100_000, ge=0, le=_MANY, description="Jobs that have ended and are kept; the newest.")
    job_days: float = Field(
        0.0, ge=0, le=_MANY, allow_inf_nan=False, description="Days that a job is kept after its end; 0 for no limit."
    )
    reserve_mb: int = Field(
        0, ge=0, le=_MANY, description="Megabytes of the library's disk kept for removals; 0 for max_upload_mb + 16."
    )
    drain_seconds: float = Field(
        20.0, ge=0, allow_inf_nan=False, description="Seconds that running jobs are given when the server stops."
    )
    log_format: LogFormat = Field("text", description="Lines of text, or one JSON object a line.")
    traces: str = Field("", description="URL of an OTLP collector that traces are sent to; none without.")

    open: bool = Field(False, description="Serve callers without a key at any address while there are no keys.")
    requests_per_minute: int = Field(
        0, ge=0, le=_MANY, description="Calls of one key, or address without; 0 for no limit."
    )
    webhook_hosts: str = Field("", description="Hosts that are told when jobs end, with commas between; none without.")
    webhook_secret: str = Field("", description="Secret that webhooks are signed with, 16 characters or more.")
    root_path: str = Field("", description="Path under which a proxy has the service, such as /shapes.")
    allowed_hosts: str = Field(
        "", description="Names that callers without a key may call the service by; * for all. Addresses always may."
    )
    trusted_proxies: str = Field(
        "", description="Addresses of proxies whose X-Forwarded-For is believed, with commas between; * for all."
    )
    cors_origins: str = Field("", description="Web sites whose pages may call: origins, with commas between them.")

    @field_validator("job_memory_mb")
    @classmethod
    def _check_memory(cls, value: int, info: ValidationInfo) -> int:
        if value <= info.data.get("max_upload_mb", 0):
            setting = "max_upload_mb"
            reason = "should be more than {setting}, for a job has the whole of its upload in memory"
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
            raise ValueError("'*' stands for all web sites, so none is named beside it")
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
            raise ValueError(f"begins as the service's own paths do: {value!r}")
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
    def _check_folder(cls, value: str) -> str:
        if value and not Path(value).is_dir():
            raise ValueError(f"there is no folder {value}")
        return value

    @field_validator("webhook_secret")
    @classmethod
    def _check_secret(cls, value: str, info: ValidationInfo) -> str:
        if info.data.get("webhook_hosts") and len(value) < _SHORTEST_SECRET:
            raise ValueError(f"should have {_SHORTEST_SECRET} characters or more where webhook_hosts names hosts")
        return value

    @property
    def webhook_plan(self) -> WebhookPlan | None:
        """The plan of webhooks; None if there are none."""
        hosts = [name.lower() for name in _listed(self.webhook_hosts)]
        return WebhookPlan(hosts, self.webhook_secret) if hosts else None

    @property
    def backup_plan(self) -> BackupPlan | None:
        """The plan of scheduled backups; None if there are none."""
        if not self.backup_folder:
            return None
        return BackupPlan(Path(self.backup_folder), self.backup_hours, self.backup_keep)

    @property
    def proxies(self) -> list[str]:
        """The addresses and networks of trusted proxies."""
        return _listed(self.trusted_proxies)

    @property
    def reserve_bytes(self) -> int:
        """Reserved bytes of the library's disk: removing a shape overwrites its whole file."""
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
