"""The senders of jobs: their API keys, the jobs that they may access, and idempotency keys."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from typing import Annotated, Final

from fastapi import Header, Request

from unbend.api.context import KEY
from unbend.api.schema.fields import VISIBLE_NAME
from unbend.api.server.service import service_of
from unbend.api.server.webhooks import check_callback
from unbend.errors import NotFoundError, ParameterError
from unbend.library.jobs import Sender
from unbend.library.keys import KeyRecord
from unbend.library.records import JobRecord
from unbend.library.requests import FileRequest, QueryRequest, ShapeRequest, Upload, kind_of

_VALID_NAME: Final = re.compile(VISIBLE_NAME)

IdempotencyKey = Annotated[
    str | None,
    Header(
        description="A unique name of this request, 1 to 255 visible characters. Repeating the request with it within "
        "24 hours returns the same job. Nothing is kept of a request that made no job.",
        pattern=VISIBLE_NAME,
    ),
]


def key_of(request: Request) -> KeyRecord | None:
    """Return the API key of a request; None if the service needs no keys."""
    key: KeyRecord | None = request.scope.get(KEY)
    return key


def owner_of(request: Request) -> str | None:
    """Return the owner of the jobs that a request may access; None for all jobs."""
    key = key_of(request)
    return None if key is None or key.scope == "admin" else key.id


def may_see(owner: str | None, job: JobRecord) -> bool:
    """Return whether `owner` may see `job`: its own jobs and those without an owner; None may see every job."""
    return not (owner and job.owner and job.owner != owner)


def must_see(request: Request, job: JobRecord) -> JobRecord:
    """Return a job; NotFoundError if it belongs to another key."""
    if not may_see(owner_of(request), job):
        raise NotFoundError(f"no job {job.id}; it may have ended long ago and been deleted")
    return job


def sender_of(
    request: Request, upload: Upload, job_request: ShapeRequest | QueryRequest, callback: str | None = None
) -> Sender:
    """Return the sender of an upload or a query, with its idempotency hashes and its webhook.

    Raises
    ------
    ParameterError
        If the header Idempotency-Key is not 1 to 255 visible ASCII characters.
    UnsuitedError
        If the settings do not allow the webhook.
    """
    key = upload.key
    sent = [
        kind_of(job_request), callback, key.sha256, key.parameters, key.policy, upload.file_type, job_request.as_dict(),
    ]  # fmt: skip
    return _sender(request, sent, callback)


def sender_of_file(request: Request, shape_id: str, file_request: FileRequest) -> Sender:
    """Return the sender of a request for a file of a stored shape; raises ParameterError as `sender_of` does."""
    return _sender(request, [kind_of(file_request), shape_id, file_request.as_dict()])


def _sender(request: Request, sent: Sequence[object], callback: str | None = None) -> Sender:
    """Return a sender; `sent` is all that a repetition of its request must have in common with it."""
    key = key_of(request)
    owner = key.id if key else None
    name = request.headers.get("idempotency-key")
    webhook = check_callback(callback, service_of(request).settings.webhook_plan) if callback else None
    if name is None:
        return Sender(owner, callback=webhook)
    if not _VALID_NAME.fullmatch(name):
        raise ParameterError("Idempotency-Key must have 1 to 255 visible characters of ASCII")
    return Sender(owner, _hash([owner, name]), _hash(sent), webhook)


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
