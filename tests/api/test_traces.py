"""Traces of a real server, as a collector on loopback receives them."""

from __future__ import annotations

import json
import secrets
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span, Status

from tests.support.server import (
    DAMAGED,
    ENDLESS,
    SAMPLES,
    Server,
    ended,
    endless_mesh,
    medium_mesh,
    post_mesh,
    without_settings,
)
from unbend import MeshPolicy, Parameters
from unbend.api.server.configuration import read_settings
from unbend.api.server.traces import FLUSH_SECONDS, Traces
from unbend.errors import ParameterError
from unbend.library.records import JobRecord
from unbend.progress import STAGES

FEW = json.dumps(SAMPLES)
PATIENCE = 30.0


@dataclass
class Collector:
    """Collects the spans received over OTLP."""

    url: str = ""
    spans: list[Span] = field(default_factory=list)
    resources: list[dict[str, object]] = field(default_factory=list)
    raw: bytes = b""
    paths: set[str] = field(default_factory=set)

    def take(self, path: str, body: bytes) -> None:
        self.raw += body
        self.paths.add(path)
        for group in ExportTraceServiceRequest.FromString(body).resource_spans:
            self.resources.append(attributes(group.resource))
            for scope in group.scope_spans:
                self.spans += scope.spans

    def until(self, found: Callable[[Span], bool], count: int = 1) -> list[Span]:
        """Wait until `count` spans match, and return them."""
        end = time.monotonic() + PATIENCE
        while len(chosen := [span for span in list(self.spans) if found(span)]) < count:
            assert time.monotonic() < end, sorted(span.name for span in self.spans)
            time.sleep(0.05)
        return chosen

    def of_job(self, job_id: str) -> Span:
        return self.until(lambda span: span.name.endswith(" job") and attributes(span)["unbend.job.id"] == job_id)[0]

    def below(self, parent: Span, count: int) -> dict[str, Span]:
        return {span.name: span for span in self.until(lambda span: span.parent_span_id == parent.span_id, count)}


def attributes(holder) -> dict[str, object]:
    return {each.key: getattr(each.value, each.value.WhichOneof("value")) for each in holder.attributes}


def listening(answer: Callable[[str, bytes], None]) -> ThreadingHTTPServer:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            answer(self.path, self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()
    return server


def address(server: ThreadingHTTPServer) -> str:
    return f"http://127.0.0.1:{server.server_address[1]}"


@pytest.fixture(scope="module")
def collector() -> Iterator[Collector]:
    found = Collector()
    server = listening(found.take)
    found.url = address(server)
    yield found
    server.shutdown()
    server.server_close()


@pytest.fixture(scope="module")
def traced(collector, tmp_path_factory) -> Iterator[Server]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OTEL_BSP_SCHEDULE_DELAY", "50")
        patch.setenv("OTEL_INSTRUMENTATION_HTTP_CAPTURE_HEADERS_SERVER_REQUEST", ".*")
        with Server(tmp_path_factory.mktemp("traced"), workers=1, traces=collector.url, drain_seconds=0) as running:
            yield running


def traceparent() -> tuple[str, bytes, bytes]:
    trace, parent = secrets.token_bytes(16), secrets.token_bytes(8)
    return f"00-{trace.hex()}-{parent.hex()}-01", trace, parent


def test_the_span_of_a_job_is_a_child_of_its_upload_and_contains_its_stages(collector, traced):
    header, trace, caller = traceparent()
    before = time.time_ns()
    with traced.http() as http:
        response = http.post(
            "/v1/shapes",
            files={"file": ("m.ply", medium_mesh())},
            data={"parameters": FEW},
            headers={"traceparent": header, "X-Request-ID": "an-upload"},
        )
        job = ended(http, response)
    after = time.time_ns()
    (upload,) = collector.until(lambda span: attributes(span).get("unbend.request_id") == "an-upload")
    assert (upload.trace_id, upload.parent_span_id, upload.name) == (trace, caller, "POST /v1/shapes")
    assert upload.kind == Span.SPAN_KIND_SERVER
    reported = attributes(upload)
    assert (reported["http.route"], reported["http.response.status_code"], reported["unbend.job.id"]) == (
        "/v1/shapes",
        202,
        job["id"],
    )

    span = collector.of_job(job["id"])
    assert (span.name, span.trace_id, span.parent_span_id) == ("shape job", trace, upload.span_id)
    reported = attributes(span)
    assert (reported["unbend.job.outcome"], reported["unbend.job.attempts"]) == ("succeeded", 1)
    assert reported["unbend.shape.id"] == job["shape_id"]
    assert [(event.name, attributes(event)) for event in span.events] == [("attempt", {"unbend.job.attempt": 1})]
    assert span.status.code == Status.STATUS_CODE_UNSET

    parts = collector.below(span, len(STAGES))
    assert set(parts) == {"waiting", *STAGES[1:]}
    assert before < upload.start_time_unix_nano < span.start_time_unix_nano < span.end_time_unix_nano < after
    assert span.start_time_unix_nano == parts["waiting"].start_time_unix_nano
    assert parts["waiting"].end_time_unix_nano == span.events[0].time_unix_nano
    last = parts["waiting"].end_time_unix_nano
    for stage in STAGES[1:]:
        assert last <= parts[stage].start_time_unix_nano <= parts[stage].end_time_unix_nano
        last = parts[stage].end_time_unix_nano
    assert last <= span.end_time_unix_nano
    computing = sum(parts[stage].end_time_unix_nano - parts[stage].start_time_unix_nano for stage in STAGES[1:])
    assert computing > 0.3 * (span.end_time_unix_nano - parts["waiting"].end_time_unix_nano)

    assert collector.paths == {"/v1/traces"}
    assert collector.resources[0]["service.name"] == "unbend"
    assert collector.resources[0]["service.version"]


def test_the_span_of_a_query_job_is_a_child_of_its_request(collector, traced):
    header, trace, _ = traceparent()
    with traced.http() as http:
        answer = http.post(
            "/v1/queries",
            files={"file": ("m.ply", medium_mesh())},
            data={"parameters": FEW},
            headers={"traceparent": header, "Prefer": "wait=60"},
        )
        assert answer.status_code == 200
    spans = {span.name: span for span in collector.until(lambda span: span.trace_id == trace, 2 + len(STAGES))}
    assert spans["query job"].parent_span_id == spans["POST /v1/queries"].span_id
    assert spans["POST /v1/queries"].end_time_unix_nano > spans["query job"].end_time_unix_nano


def test_the_span_of_a_failed_or_cancelled_job_has_its_outcome(collector, traced):
    with traced.http() as http:
        bad = ended(http, post_mesh(http, DAMAGED, file_name="bad.off"))
        mesh = endless_mesh()
        begun, in_hand, waits = (
            post_mesh(http, mesh, parameters=json.dumps(ENDLESS | {"dimensions": dimensions})).headers["Location"]
            for dimensions in (3, 4, 5)  # the runner gives a worker two jobs at a time
        )
        while http.get(in_hand).json()["state"] != "running":
            time.sleep(0.05)
        cancelled = [http.delete(url).json() for url in (waits, in_hand, begun)]
    span = collector.of_job(bad["id"])
    reported = attributes(span)
    assert (reported["unbend.job.outcome"], reported["error.type"]) == ("failed", "mesh_read")
    assert (reported["unbend.job.stage"], span.status.code) == ("reading", Status.STATUS_CODE_ERROR)
    assert set(collector.below(span, 1)) == {"waiting"}
    never, _, stopped = (collector.of_job(job["id"]) for job in cancelled)
    assert attributes(never)["unbend.job.outcome"] == attributes(stopped)["unbend.job.outcome"] == "cancelled"
    assert (len(never.events), len(stopped.events)) == (0, 1)
    assert stopped.status.code == Status.STATUS_CODE_UNSET
    (waiting,) = collector.below(never, 1).values()
    assert waiting.end_time_unix_nano == never.end_time_unix_nano


def test_spans_are_named_by_route_templates_and_contain_no_secrets(collector, traced):
    header, trace, _ = traceparent()
    headers = {"traceparent": header, "Authorization": "Bearer unbend_a_s3cret", "Cookie": "s3cret"}
    with traced.http() as http:
        http.get("/v1/shapes?cursor=s3cret&limit=1", headers=headers)
        http.get("/v1/shapes/none", headers=headers)
        http.get("/elsewhere", headers=headers)
        http.request("PROPFIND", "/v1/shapes", headers=headers)
        for probe in ("livez", "readyz", "metrics"):
            assert http.get(f"/v1/{probe}", headers=headers).status_code == 200
        http.get("/v1/capacity", headers=headers)
    collector.until(lambda span: span.trace_id == trace and span.name == "GET /v1/capacity")
    names = [span.name for span in collector.spans if span.trace_id == trace]
    assert names == ["GET /v1/shapes", "GET /v1/shapes/{shape_id}", "GET", "other /v1/shapes", "GET /v1/capacity"]
    assert b"s3cret" not in collector.raw


def test_an_unsampled_request_has_no_span_and_malformed_headers_do_no_harm(collector, traced):
    header, trace, _ = traceparent()
    with traced.http() as http:
        http.get("/v1/capacity", headers={"traceparent": header[:-2] + "00"})
        http.get("/v1/capacity", headers={"traceparent": "nonsense"})
    host, port = traced.url.removeprefix("http://").split(":")
    for odd in (rb"User-Agent: \xff\x", b"User-Agent: \xff\\x", b"traceparent: \xff\\u", b"tracestate: \xff\\N{"):
        with socket.create_connection((host, int(port)), 30) as raw:
            raw.sendall(b"GET /v1/shapes HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n" + odd + b"\r\n\r\n")
            assert raw.makefile("rb").readline().startswith(b"HTTP/1.1 200 ")
    collector.until(lambda span: span.name == "GET /v1/shapes" and not span.parent_span_id, 4)
    assert not any(span.trace_id == trace for span in collector.spans)


def stopped_in(server: Server) -> float:
    begun = time.monotonic()
    server.stop()
    assert server.process.returncode in {0, -signal.SIGTERM}  # a clean exit
    return time.monotonic() - begun


def test_unsent_spans_are_sent_when_the_server_stops(collector, tmp_path, monkeypatch):
    monkeypatch.setenv("OTEL_BSP_SCHEDULE_DELAY", "600000")
    header, trace, _ = traceparent()
    with Server(tmp_path, workers=1, ready=False, traces=f"{collector.url}/v1/traces") as server:
        with server.http() as http:
            assert http.get("/v1/capacity", headers={"traceparent": header}).status_code == 200
        assert not any(span.trace_id == trace for span in collector.spans)
        stopped_in(server)
    assert [span.name for span in collector.spans if span.trace_id == trace] == ["GET /v1/capacity"]


def test_a_collector_that_never_answers_delays_neither_requests_nor_the_exit(tmp_path, monkeypatch):
    monkeypatch.setenv("OTEL_BSP_SCHEDULE_DELAY", "50")
    asked, end = threading.Event(), threading.Event()

    def silent(_path: str, _body: bytes) -> None:
        asked.set()
        end.wait(PATIENCE)

    deaf = listening(silent)
    try:
        with Server(tmp_path, workers=1, ready=False, traces=address(deaf)) as server:
            with server.http() as http:
                assert http.get("/v1/capacity").status_code == 200
                assert asked.wait(PATIENCE)
                begun = time.monotonic()
                assert all(http.get("/v1/capacity").status_code == 200 for _ in range(20))
                assert time.monotonic() - begun < 5  # the exporter waits for ten seconds
            assert stopped_in(server) < 9
    finally:
        end.set()
        deaf.shutdown()
        deaf.server_close()


def shape_job(job_id: str, **values: object) -> JobRecord:
    now = datetime.now(UTC)
    record = JobRecord(
        id=job_id, kind="shape", state="running", stage="starting", progress=0.0, attempts=1, restarts=0,
        mesh_sha256="", file_type="ply", parameters=Parameters(), policy=MeshPolicy(), request=None, error=None,
        result=None, shape_id=None, created_at=now, started_at=now, finished_at=None, seq=1,
    )  # fmt: skip
    return replace(record, **values)


def test_a_span_has_every_attempt_and_no_parent_if_the_upload_is_unknown(collector):
    traces, job_id = Traces(collector.url), secrets.token_hex(8)
    begin = datetime.now(UTC)
    later = begin + timedelta(seconds=2)
    traces.begun(shape_job(job_id, created_at=begin, started_at=begin))
    traces.begun(shape_job(job_id, created_at=begin, started_at=later, attempts=2))
    error = {"code": "worker_lost", "message": "", "advice": ""}
    traces.ended(shape_job(job_id, state="failed", created_at=begin, finished_at=later, attempts=2, error=error))
    traces.close()
    span = collector.of_job(job_id)
    assert [attributes(event)["unbend.job.attempt"] for event in span.events] == [1, 2]
    assert span.events[1].time_unix_nano - span.events[0].time_unix_nano == 2_000_000_000
    assert not span.parent_span_id
    assert attributes(span)["error.type"] == "worker_lost"


def test_the_memory_for_unfinished_jobs_is_bounded(collector):
    traces, job, own = Traces(collector.url), shape_job(""), secrets.token_hex(8)
    for number in range(20_001):
        traces.begun(replace(job, id=f"{own}-{number}"))
    for number in (0, 1):
        traces.ended(replace(job, id=f"{own}-{number}", state="succeeded"))
    traces.close()
    assert [len(collector.of_job(f"{own}-{number}").events) for number in (0, 1)] == [0, 1]


def test_an_unreachable_collector_delays_nothing(caplog):
    traces = Traces("http://127.0.0.1:9")
    begun = time.monotonic()
    traces.ended(shape_job("a", state="succeeded", finished_at=datetime.now(UTC)))
    assert time.monotonic() - begun < 1
    traces.close()
    assert time.monotonic() - begun < FLUSH_SECONDS + 2
    assert "exporting span" in caplog.text


def test_tracing_packages_are_imported_only_on_demand_and_without_warnings():
    code = (
        "import sys; from unbend.api import create_app; create_app();"
        # later versions of FastAPI import the OpenTelemetry API
        "parts = ('opentelemetry.sdk', 'opentelemetry.exporter', 'opentelemetry.instrumentation', 'requests');"
        "print([name for name in sys.modules if name.startswith(parts)]);"
        "import warnings; warnings.simplefilter('error'); import unbend.api.server.traces"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=without_settings()
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "[]\n", "")


@pytest.mark.parametrize(
    "missing", ["opentelemetry.sdk", "opentelemetry.exporter.otlp.proto.http", "opentelemetry.instrumentation.asgi"]
)
def test_a_server_with_traces_does_not_start_without_the_packages(monkeypatch, missing, tmp_path):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ParameterError, match=r"--traces: traces need more packages: pip install 'unbend\[traces\]'"):
        read_settings({"traces": "http://localhost:4318", "library": str(tmp_path / "a.db")})
    assert not read_settings({"library": str(tmp_path / "a.db")}).traces
