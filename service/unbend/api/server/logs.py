"""Log formats: lines of text or JSON, with the ids of the request and the job."""

from __future__ import annotations

import json
import logging
from datetime import UTC, datetime
from typing import Any, Final, Literal, get_args

from unbend.api.context import CURRENT_REQUEST
from unbend.jobs.observer import CURRENT_JOB

LogFormat = Literal["text", "json"]


class TextFormatter(logging.Formatter):
    """Formats time, level, logger and message, followed by the ids in brackets."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  logging's own name
        """Append the ids of the request and the job."""
        ids = " ".join(f"{name}={value}" for name, value in _ids().items())
        return super().formatMessage(record) + (f" [{ids}]" if ids else "")


class JsonFormatter(logging.Formatter):
    """Formats a record as one line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        """Return a record as one line of JSON."""
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            **_ids(),
            **getattr(record, "details", {}),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, ensure_ascii=False, default=str)


_FORMATTERS: Final[dict[LogFormat, type[logging.Formatter]]] = {"text": TextFormatter, "json": JsonFormatter}


def log_config(log_format: LogFormat) -> dict[str, Any]:
    """Return the configuration of all loggers, including uvicorn's, for `logging.config.dictConfig`."""
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {name: {"()": _FORMATTERS[name]} for name in get_args(LogFormat)},
        "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": log_format}},
        "loggers": {name: {"level": "INFO"} for name in ("unbend", "uvicorn")},
        "root": {"handlers": ["stderr"], "level": "WARNING"},
    }


def _ids() -> dict[str, str]:
    values = {"request_id": CURRENT_REQUEST.get(), "job_id": CURRENT_JOB.get()}
    return {name: value for name, value in values.items() if value is not None}
