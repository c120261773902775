"""The senders of jobs: which key, whose jobs it sees, and how a repeated request is recognised."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Annotated, Any, Final

from fastapi import Header, Request

from unbend.api.access import KEY
from unbend.api.service import service_of
from unbend.api.webhooks import check_callback
from unbend.errors import NotFoundError, ParameterError
from unbend.jobs import Upload
from unbend.library.key import UploadKey
from unbend.library.keys import KeyRecord
from unbend.library.queue import Sender
from unbend.library.records import JobRecord

_SANE: Final = re.compile(r"[\x21-\x7e]{1,255}")

IdempotencyKey = Annotated[
    str | None,
    Header(
        description="A name of this request, 1 to 255 visible characters. The same request sent again under it within "
        "24 hours is answered with the same job.",
        pattern=r"^[\x21-\x7e]{1,255}$",
    ),
]


def key_of(request: Request) -> KeyRecord | None:
    """Return the key that a call came with; None where the service asks for none."""
    key: KeyRecord | None = request.scope.get(KEY)
    return key


def owner_of(request: Request) -> str | None:
    """Return whose jobs a call may see; None where it may see all."""
    key = key_of(request)
    return None if key is None or key.scope == "admin" else key.id


def must_see(request: Request, job: JobRecord) -> JobRecord:
    """Return a job; NotFoundError where it is another key's."""
    owner = owner_of(request)
    if owner and job.owner and job.owner != owner:
        raise NotFoundError(f"no job {job.id}: there is none, or it ended long ago and was forgotten")
    return job


def sender_of(
    request: Request, kind: str, upload: Upload, asked: dict[str, Any], callback: str | None = None
) -> Sender:
    """Return who sends a job, what it is known by if it is sent again, and who is told of its end.

    Raises
    ------
    ParameterError
        If the header Idempotency-Key is not 1 to 255 visible characters of ASCII.
    UnsuitedError
        If this service does not call the callback.
    """
    key = key_of(request)
    owner = key.id if key else None
    name = request.headers.get("idempotency-key")
    told = check_callback(callback, service_of(request).settings.webhook_plan) if callback else None
    if name is None:
        return Sender(owner, callback=told)
    if not _SANE.fullmatch(name):
        raise ParameterError("Idempotency-Key must have 1 to 255 visible characters of ASCII")
    what = UploadKey.of(upload.data, upload.parameters, upload.policy)
    sent = [kind, callback, what.sha256, what.parameters, what.policy, upload.file_type, asked]
    return Sender(owner, _hash([owner, name]), _hash(sent), told)


def _hash(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
