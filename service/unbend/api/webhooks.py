"""Webhooks: a caller's own address is told when a job ends, signed as Standard Webhooks have it.

Only hosts that the settings name are called. The store has what is still to be told, so that a restart forgets nothing.
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
from functools import partial
from typing import Any, Final
from urllib.parse import urlsplit

import httpx

from unbend.api.addresses import is_loopback
from unbend.errors import StoreError, UnsuitedError
from unbend.jobs import JobRunner
from unbend.library import Library, queue
from unbend.library.records import JobRecord

logger = logging.getLogger("unbend.webhooks")

ATTEMPTS: Final = 10
_LOOK_SECONDS: Final = 1.0
_FIRST_SECONDS: Final = 2.0
_LONGEST_SECONDS: Final = 3600.0
_TIMEOUT: Final = httpx.Timeout(10.0)
_AT_A_TIME: Final = 8
_MOST_URL: Final = 2000


@dataclass(frozen=True)
class WebhookPlan:
    """Hosts that may be called, in lower case, and the secret that calls are signed with."""

    hosts: Sequence[str]
    secret: str


def check_callback(url: str, plan: WebhookPlan | None) -> str:
    """Return an address that a job's end may be told to.

    Raises
    ------
    UnsuitedError
        If webhooks are off, the host is not named in the settings, or the address is not https; http will do for this
        machine.
    """
    if plan is None:
        raise UnsuitedError("callback: this service calls nobody; it names hosts in UNBEND_WEBHOOK_HOSTS if it does")
    try:
        parts = urlsplit(url)
        host, _ = (parts.hostname or "").lower(), parts.port
    except ValueError:
        raise UnsuitedError("callback: not an address") from None
    if len(url) > _MOST_URL or parts.username or parts.password or not url.isprintable():
        raise UnsuitedError("callback: not an address that is called")
    if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(host)):
        raise UnsuitedError("callback: must begin with https://")
    if host not in plan.hosts:
        raise UnsuitedError(f"callback: {host[:100]!r} is not among the hosts that this service calls")
    return url


class Webhooks:
    """Tells addresses of jobs that ended; used within one event loop.

    An answer other than 2xx, a redirect too, is a failure. It is tried again after 2 seconds, and then after twice as
    long each time, an hour at most, with jitter, ten times in all.
    """

    def __init__(self, library: Library, runner: JobRunner, plan: WebhookPlan) -> None:
        self._store = library.store
        self._runner = runner
        self._plan = plan
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin."""
        self._task = asyncio.create_task(self._run(), name="unbend webhooks")

    async def stop(self) -> None:
        """Tell nobody any more; the next server goes on."""
        if self._task:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        async with httpx.AsyncClient(timeout=_TIMEOUT, follow_redirects=False, trust_env=False) as http:
            while True:
                try:
                    due = await self._store.fetch(partial(queue.due_callbacks, now=datetime.now(UTC), limit=_AT_A_TIME))
                    await asyncio.gather(*(self._tell(http, job) for job in due))
                except StoreError as error:
                    logger.error("webhooks wait for the store: %s", error)  # noqa: TRY400
                    due = []
                if not due:
                    await asyncio.sleep(_LOOK_SECONDS)

    async def _tell(self, http: httpx.AsyncClient, job: JobRecord) -> None:
        attempts = job.callback_attempts + 1
        try:
            content = json.dumps(told_of(job)).encode()
            headers = {"Content-Type": "application/json", **signed(self._plan.secret, job.id, content)}
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
        await self._runner.write(partial(queue.note_callback, job_id=job.id, attempts=attempts, due=again))


def told_of(job: JobRecord) -> dict[str, Any]:
    """Return what a webhook says of a job: nothing of its answer, which the job has."""
    told = {"id": job.id, "kind": job.kind, "state": job.state, "shape_id": job.shape_id}
    code = job.error["code"] if job.error else None
    ended = (job.finished_at or job.created_at).isoformat()
    return {"type": "job.ended", "timestamp": ended, "data": {**told, "error": code}}


def signed(secret: str, message_id: str, content: bytes, now: datetime | None = None) -> dict[str, str]:
    """Return the headers of Standard Webhooks: id, time and signature of a message."""
    moment = str(int((now or datetime.now(UTC)).timestamp()))
    key = base64.b64decode(secret.removeprefix("whsec_")) if secret.startswith("whsec_") else secret.encode()
    digest = hmac.new(key, f"{message_id}.{moment}.".encode() + content, hashlib.sha256).digest()
    return {
        "webhook-id": message_id,
        "webhook-timestamp": moment,
        "webhook-signature": f"v1,{base64.b64encode(digest).decode()}",
    }
