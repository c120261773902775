"""Webhooks that report the end of a job to the caller's URL, signed by the Standard Webhooks specification.

Only hosts in the settings are called. The store keeps pending webhooks, so that a restart loses none.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import json
import logging
import random
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Final
from urllib.parse import urlsplit

import httpx

from unbend.api.server.addresses import is_loopback
from unbend.api.server.background import Background
from unbend.errors import StoreError, UnsuitedError
from unbend.library.jobs import Jobs
from unbend.library.records import JobRecord

logger = logging.getLogger("unbend.webhooks")

ATTEMPTS: Final = 10
_LOOK_SECONDS: Final = 1.0
_FIRST_SECONDS: Final = 2.0
_LONGEST_SECONDS: Final = 3600.0
_TIMEOUT: Final = httpx.Timeout(10.0)
_AT_A_TIME: Final = 8
_LEASE: Final = timedelta(minutes=1)
"""Time after which the webhook of a server that died is called by another; far above `_TIMEOUT`."""
_MOST_URL: Final = 2000
_BASE64_PREFIX: Final = "whsec_"


@dataclass(frozen=True)
class WebhookPlan:
    """The allowed hosts, in lower case, and the secret of the signatures."""

    hosts: Sequence[str]
    secret: str


def check_callback(url: str, plan: WebhookPlan | None) -> str:
    """Return the URL of a webhook if it is allowed.

    Raises
    ------
    UnsuitedError
        If webhooks are off, the settings do not allow the host, or the URL is invalid or not https. http is allowed for
        hosts on this machine.
    """
    if plan is None:
        raise UnsuitedError("callback: this service has no webhooks; set UNBEND_WEBHOOK_HOSTS to allow hosts")
    try:
        parts = urlsplit(url)
        host, _ = (parts.hostname or "").lower(), parts.port
    except ValueError:
        raise UnsuitedError("callback: not a URL") from None
    if len(url) > _MOST_URL or parts.username or parts.password or not url.isprintable():
        raise UnsuitedError(
            "callback: the URL is too long, or contains a user name, a password or unprintable characters"
        )
    if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(host)):
        raise UnsuitedError("callback: must begin with https://")
    if host not in plan.hosts:
        raise UnsuitedError(f"callback: {host[:100]!r} is not an allowed host of this service")
    return url


class Webhooks(Background):
    """Calls the webhooks of ended jobs; used within one event loop.

    Any response except 2xx is a failure, including a redirect. There are up to ten attempts. The first pause is 2
    seconds. Each further pause is twice as long, but at most an hour, with jitter.
    """

    name = "webhooks"

    def __init__(self, jobs: Jobs, plan: WebhookPlan) -> None:
        super().__init__()
        self._jobs = jobs
        self._plan = plan

    async def _run(self) -> None:
        async with httpx.AsyncClient(timeout=_TIMEOUT, follow_redirects=False, trust_env=False) as http:
            while True:
                try:
                    due = await self._jobs.take_callbacks(_AT_A_TIME, _LEASE)
                    await asyncio.gather(*(self._call(http, job) for job in due))
                except StoreError as error:
                    logger.error("webhooks wait for the store: %s", error)  # noqa: TRY400
                    due = []
                if not due:
                    await asyncio.sleep(_LOOK_SECONDS)

    async def _call(self, http: httpx.AsyncClient, job: JobRecord) -> None:
        attempts = job.callback_attempts + 1
        try:
            content = json.dumps(payload_of(job)).encode()
            headers = {"Content-Type": "application/json", **sign(self._plan.secret, job.id, content)}
            response = await http.post(job.callback or "", content=content, headers=headers)
            failure = "" if response.is_success else f"status {response.status_code}"
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            failure = type(error).__name__
        again = None
        if failure and attempts < ATTEMPTS:
            pause = min(_FIRST_SECONDS * 2 ** (attempts - 1), _LONGEST_SECONDS) * random.uniform(0.8, 1.2)  # noqa: S311
            again = datetime.now(UTC) + timedelta(seconds=pause)
        if failure:
            logger.warning("the webhook of job %s failed, attempt %d: %s", job.id, attempts, failure)
        await asyncio.wrap_future(self._jobs.schedule_callback(job.id, attempts, again))


def payload_of(job: JobRecord) -> dict[str, Any]:
    """Return the content of a webhook, without the job's result."""
    data = {"id": job.id, "kind": job.kind, "state": job.state, "shape_id": job.shape_id}
    code = job.error["code"] if job.error else None
    ended = (job.finished_at or job.created_at).isoformat()
    return {"type": "job.ended", "timestamp": ended, "data": {**data, "error": code}}


def signing_key(secret: str) -> bytes:
    """Return the key of a secret: bytes in base64 after `whsec_`, or else text; ValueError if the base64 is invalid."""
    if not secret.startswith(_BASE64_PREFIX):
        return secret.encode()
    try:
        return base64.b64decode(secret.removeprefix(_BASE64_PREFIX))
    except ValueError:
        raise ValueError(f"should be base64 after {_BASE64_PREFIX}") from None


def sign(secret: str, message_id: str, content: bytes, now: datetime | None = None) -> dict[str, str]:
    """Return the headers of Standard Webhooks: id, time and signature of a message."""
    moment = str(int((now or datetime.now(UTC)).timestamp()))
    digest = hmac.new(signing_key(secret), f"{message_id}.{moment}.".encode() + content, hashlib.sha256).digest()
    return {
        "webhook-id": message_id,
        "webhook-timestamp": moment,
        "webhook-signature": f"v1,{base64.b64encode(digest).decode()}",
    }
