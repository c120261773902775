"""OpenTelemetry traces over OTLP: a span for each request, and below it a span for each of its jobs.

This module needs the packages of the extra `traces`. It is imported only if the setting `traces` is given.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Final
from urllib.parse import urlsplit

from opentelemetry.context import Context
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.instrumentation.asgi import OpenTelemetryMiddleware
from opentelemetry.metrics import NoOpMeterProvider
from opentelemetry.sdk.resources import SERVICE_NAME, SERVICE_VERSION, OTELResourceDetector, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import NonRecordingSpan, Span, SpanContext, StatusCode, get_current_span, set_span_in_context
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend import __version__
from unbend.api.context import CURRENT_REQUEST, PROBES, method_of, route_of
from unbend.jobs.observer import CURRENT_JOB, NoObserver
from unbend.library.records import JobRecord

FLUSH_SECONDS: Final = 3.0
"""Time to send the last spans when the server stops."""

_MOST_JOBS: Final = 20_000  # unfinished jobs kept in memory: twice the default limit of the queue
_SHOWN_HEADERS: Final = frozenset({b"traceparent", b"tracestate", b"user-agent"})
_SHOWN: Final = ("type", "asgi", "http_version", "method", "scheme", "path", "client", "server")
_WHOLE: Final = "unbend.scope"


@dataclass(frozen=True)
class _PendingJob:
    """Data of a job until it ends."""

    request: SpanContext | None = None
    begun: tuple[tuple[int, datetime], ...] = ()
    """Number and time of each attempt."""
    seconds: Mapping[str, float] | None = None
    """Time of each stage, in order; the last stage ended at `computed`."""
    computed: datetime | None = None


class Traces(NoObserver):
    """Creates spans, and sends them in a thread; a `JobObserver`.

    A slow or absent collector loses spans, but never delays requests or jobs: the exporter's queue drops what does not
    fit. OpenTelemetry's own variables (`OTEL_...`) configure everything else.

    Parameters
    ----------
    endpoint : str
        URL of an OTLP collector over HTTP; without a path, /v1/traces is added.
    """

    def __init__(self, endpoint: str) -> None:
        # Selects the stable semantic conventions, when the middleware is created.
        os.environ.setdefault("OTEL_SEMCONV_STABILITY_OPT_IN", "http")
        ours = Resource.create({SERVICE_NAME: "unbend", SERVICE_VERSION: __version__})
        self.provider = TracerProvider(resource=ours.merge(OTELResourceDetector().detect()), shutdown_on_exit=False)
        self._exporter = OTLPSpanExporter(endpoint=_with_path(endpoint))
        self.provider.add_span_processor(BatchSpanProcessor(self._exporter))
        self._tracer = self.provider.get_tracer("unbend", __version__)
        self._jobs: dict[str, _PendingJob] = {}
        self._lock = threading.Lock()

    def close(self) -> None:
        """Send the remaining spans, for at most `FLUSH_SECONDS`."""
        thread = threading.Thread(target=self.provider.shutdown, daemon=True)
        thread.start()
        thread.join(FLUSH_SECONDS)
        if thread.is_alive():
            self._exporter.shutdown()

    def submitted(self, job: JobRecord) -> None:
        """Record the request of a job."""
        request = get_current_span().get_span_context()
        if request.is_valid:
            self._remember(job.id, request=request)

    def begun(self, job: JobRecord) -> None:
        """Record the time of an attempt."""
        with self._lock:
            before = self._jobs.get(job.id, _PendingJob()).begun
        self._remember(job.id, begun=(*before, (job.attempts, job.started_at or job.created_at)))

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Record the times of the stages of the current job."""
        if job_id := CURRENT_JOB.get():
            self._remember(job_id, seconds=seconds, computed=datetime.now().astimezone())

    def ended(self, job: JobRecord) -> None:
        """Create the spans of a job from the recorded times."""
        with self._lock:
            known = self._jobs.pop(job.id, _PendingJob())
        above = set_span_in_context(NonRecordingSpan(known.request), Context()) if known.request else Context()
        span = self._tracer.start_span(
            f"{job.kind} job", context=above, start_time=_nanoseconds(job.created_at), attributes=_attributes(job)
        )
        for number, at in known.begun:
            span.add_event("attempt", {"unbend.job.attempt": number}, timestamp=_nanoseconds(at))
        end = _nanoseconds(job.finished_at or job.created_at)
        within = set_span_in_context(span, Context())
        first = _nanoseconds(known.begun[0][1]) if known.begun else end
        self._tracer.start_span("waiting", context=within, start_time=_nanoseconds(job.created_at)).end(first)
        self._add_stages(known, within)
        if job.state == "failed":
            span.set_status(StatusCode.ERROR, job.error["code"] if job.error else None)
        span.end(end)

    def _add_stages(self, known: _PendingJob, within: Context) -> None:
        if known.seconds is None or known.computed is None:
            return
        begin = _nanoseconds(known.computed) - round(1e9 * sum(known.seconds.values()))
        for stage, seconds in known.seconds.items():
            end = begin + round(1e9 * seconds)
            self._tracer.start_span(stage, context=within, start_time=begin).end(end)
            begin = end

    def _remember(self, job_id: str, **values: Any) -> None:
        with self._lock:
            self._jobs[job_id] = replace(self._jobs.get(job_id, _PendingJob()), **values)
            while len(self._jobs) > _MOST_JOBS:
                self._jobs.pop(next(iter(self._jobs)))


class TracedRequests:
    """OpenTelemetry's ASGI middleware, with only those parts of a request that may leave the server.

    It receives no query, and no headers except those of the trace and the user agent. Span names are path templates.
    """

    def __init__(self, app: ASGIApp, traces: Traces) -> None:
        self._app = app
        self._traced = OpenTelemetryMiddleware(
            self._within,
            default_span_details=_bare_details,
            tracer_provider=traces.provider,
            meter_provider=NoOpMeterProvider(),
            exclude_spans=["receive", "send"],
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, in a span unless it is a probe."""
        if scope["type"] == "http" and scope["path"] not in PROBES:
            await self._traced(_reduced(scope), receive, send)
        else:
            await self._app(scope, receive, send)

    async def _within(self, shown: Scope, receive: Receive, send: Send) -> None:
        scope: Scope = shown[_WHOLE]
        span = get_current_span()

        async def watching(message: Message) -> None:
            if message["type"] == "http.response.start":
                _describe(span, scope)
            await send(message)

        try:
            await self._app(scope, receive, watching)
        except Exception:
            _describe(span, scope)
            raise


def _reduced(scope: Scope) -> Scope:
    # Without headers that are not ASCII: the middleware would decode these as escapes of Python, and fail.
    headers = [(name, value) for name, value in scope["headers"] if name in _SHOWN_HEADERS and value.isascii()]
    kept = {name: scope[name] for name in _SHOWN if name in scope}
    return kept | {"query_string": b"", "headers": headers, _WHOLE: scope}


def _bare_details(scope: Scope) -> tuple[str, dict[str, str]]:
    """Return a span's name and attributes before its route is known."""
    return method_of(scope), {}


def _describe(span: Span, scope: Scope) -> None:
    if not span.is_recording():
        return
    if (route := route_of(scope)) != "unmatched":
        span.update_name(f"{method_of(scope)} {route}")
        span.set_attribute("http.route", route)
    about = {"unbend.request_id": CURRENT_REQUEST.get(), "unbend.job.id": CURRENT_JOB.get()}
    span.set_attributes({name: value for name, value in about.items() if value is not None})


def _attributes(job: JobRecord) -> dict[str, str | int]:
    found: dict[str, str | int] = {
        "unbend.job.id": job.id,
        "unbend.job.kind": job.kind,
        "unbend.job.outcome": job.state,
        "unbend.job.attempts": job.attempts,
        "unbend.job.restarts": job.restarts,
    }
    if job.shape_id:
        found["unbend.shape.id"] = job.shape_id
    if job.error:
        found |= {"error.type": job.error["code"], "unbend.job.stage": job.stage}
    return found


def _with_path(endpoint: str) -> str:
    return endpoint if urlsplit(endpoint).path.strip("/") else f"{endpoint.rstrip('/')}/v1/traces"


def _nanoseconds(time: datetime) -> int:
    return round(1e9 * time.timestamp())
