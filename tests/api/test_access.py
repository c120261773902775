"""Access control: API keys, scopes, rate limits, cross-origin requests, and the audit log."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import http.client
import json
import re
import sqlite3
import time
from dataclasses import dataclass
from urllib.parse import urlsplit

import httpx
import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, post_mesh, small_mesh
from unbend import Client, Library
from unbend.api import Settings, create_app
from unbend.errors import KeyInvalidError, ScopeError

FEW = json.dumps(SAMPLES)
ALWAYS = {"x-content-type-options": "nosniff", "referrer-policy": "no-referrer", "x-frame-options": "DENY"}
CLOSED = "default-src 'none'; frame-ancestors 'none'"


@dataclass(frozen=True)
class Keyed:
    """A server whose library has keys before it starts, so that it may listen on every address."""

    server: Server
    reader: str
    writer: str

    def call(self, method: str, path: str, key: str | None = None, **options) -> httpx.Response:
        headers = {"Authorization": f"Bearer {key}"} if key else {}
        with self.server.http() as api:
            return api.request(method, path, headers=headers, **options)


def new_key(library: object, scope: str = "read") -> str:
    with Library(str(library)) as opened:
        return opened.keys.create("a key", scope)[1]


def revoke(library: object, text: str) -> None:
    with Library(str(library)) as opened:
        opened.keys.revoke(text.split("_", 2)[1])


@pytest.fixture(scope="module")
def keyed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keyed")
    reader, writer = new_key(folder / "library.db"), new_key(folder / "library.db", "write")
    with Server(folder, workers=1, ready=False, host="0.0.0.0") as running:  # noqa: S104
        yield Keyed(running, reader, writer)


def test_a_request_without_a_key_is_refused(keyed):
    for method, path in [
        ("GET", "/v1/shapes"),
        ("POST", "/v1/shapes"),
        ("GET", "/v1/capacity"),
        ("GET", "/v1/nothing"),
    ]:
        response = keyed.call(method, path)
        assert check(response, 401, "key_required")["advice"]
        assert response.headers["www-authenticate"] == 'Bearer realm="unbend"'


def test_health_checks_and_documentation_need_no_key(keyed):
    for path in ("/v1/livez", "/docs", "/redoc", "/openapi.json"):
        assert keyed.call("GET", path).status_code == 200
    assert keyed.call("GET", "/v1/readyz").status_code in {200, 503}


def test_a_read_key_may_read_and_query_but_not_write(keyed):
    assert keyed.call("GET", "/v1/shapes", keyed.reader).status_code == 200
    check(keyed.call("POST", "/v1/queries", keyed.reader, json={"shape_id": "nobody"}), 404, "not_found")
    for method, path in [
        ("POST", "/v1/shapes"), ("PATCH", "/v1/shapes/x"), ("DELETE", "/v1/shapes/x"), ("DELETE", "/v1/jobs/x"),
    ]:  # fmt: skip
        response = keyed.call(method, path, keyed.reader)
        check(response, 403, "scope_insufficient")
        challenge = 'Bearer realm="unbend", error="insufficient_scope", scope="write"'
        assert response.headers["www-authenticate"] == challenge


def test_a_write_key_may_read_and_write(keyed):
    assert keyed.call("GET", "/v1/shapes", keyed.writer).status_code == 200
    check(keyed.call("DELETE", "/v1/shapes/x", keyed.writer), 404, "not_found")
    files = {"file": ("x.ply", small_mesh(0))}
    assert keyed.call("POST", "/v1/shapes", keyed.writer, files=files, data={"parameters": FEW}).status_code == 202


@pytest.mark.parametrize(
    "header",
    [
        "", "Bearer", "Bearer nonsense", "Basic dXNlcjpwYXNz", "{key}", "Basic {key}", "Bearer {key}x",
        "Bearer {key} {key}", "Bearer unbend_{id}_", "Bearer unbend_{id}", "Bearer _{id}_{secret}",
        "Bearer unbend_000000000000_{secret}", 'Bearer "{key}"', "Bearer Bearer {key}", "Bearer \xe9\xff",
    ],
)  # fmt: skip
def test_every_invalid_authorization_header_gets_the_same_answer(keyed, header):
    _, key_id, secret = keyed.writer.split("_", 2)
    sent = header.format(key=keyed.writer, id=key_id, secret=secret).encode("latin-1")
    with keyed.server.http() as api:
        response = api.get("/v1/shapes", headers={b"Authorization": sent})
    problem = check(response, 401, "key_invalid")
    assert problem["detail"] == "the Authorization header contains no key of this library"
    assert secret not in response.text
    assert response.headers["www-authenticate"] == 'Bearer realm="unbend", error="invalid_token"'


def test_the_authorization_scheme_ignores_case(keyed):
    with keyed.server.http() as api:
        assert api.get("/v1/shapes", headers={"Authorization": f"bEARER  {keyed.reader}"}).status_code == 200


def test_a_key_of_another_library_is_refused(keyed, tmp_path):
    check(keyed.call("GET", "/v1/shapes", new_key(tmp_path / "other.db", "write")), 401, "key_invalid")


def test_a_revoked_key_is_refused_at_once(keyed):
    key = new_key(keyed.server.library)
    assert keyed.call("GET", "/v1/shapes", key).status_code == 200
    revoke(keyed.server.library, key)
    check(keyed.call("GET", "/v1/shapes", key), 401, "key_invalid")


def test_a_request_without_a_key_is_refused_before_its_body_arrives(keyed):
    address = urlsplit(keyed.server.url)
    connection = http.client.HTTPConnection(address.hostname, address.port, timeout=30)
    connection.putrequest("POST", "/v1/shapes")
    connection.putheader("Content-Length", "1000000")
    connection.endheaders()
    assert connection.getresponse().status == 401
    connection.close()


def test_the_client_sends_its_key_and_raises_errors_of_access(keyed, monkeypatch):
    with Client(keyed.server.url, keyed.reader) as client:
        assert client.request("GET", "/v1/shapes").status_code == 200
        with pytest.raises(ScopeError) as caught:
            client.submit(small_mesh(1))
        assert (caught.value.status, caught.value.advice) == (403, ScopeError.advice)
    monkeypatch.setenv("UNBEND_API_KEY", keyed.reader)
    with Client(keyed.server.url) as client:
        client.labels()
    with Client(keyed.server.url, "unbend_x_y") as client, pytest.raises(KeyInvalidError, match="no key") as caught:
        client.submit(small_mesh(1))
    assert caught.value.status == 401


def audited(server: Server, path: str, count: int, job_id: str | None = None) -> list[dict]:
    """Wait for `count` audit lines about `path`, one of them about `job_id` if given, and return the lines."""
    end = time.monotonic() + 10
    while time.monotonic() < end:
        lines = re.findall(r" INFO unbend\.audit: (\{.*\})(?: \[[^\]]*\])?$", server.log.read_text(), re.MULTILINE)
        found = [line for line in map(json.loads, lines) if line["path"] == path]
        if len(found) >= count and job_id in {None, *(line.get("job_id") for line in found)}:
            return found
        time.sleep(0.05)
    raise AssertionError(server.log.read_text())


def test_the_audit_log_has_keys_and_outcomes_of_writes_but_no_secrets(keyed):
    path = "/v1/shapes/somebody"
    keyed.call("GET", path, keyed.writer)
    for key in (keyed.writer, keyed.reader, "unbend_x_y", None):
        keyed.call("DELETE", path, key)
    lines = audited(keyed.server, path, 4)
    writer, reader = (key.split("_", 2)[1] for key in (keyed.writer, keyed.reader))
    assert [(line["key"], line["status"]) for line in lines] == [
        (writer, 404), (reader, 403), ("none", 401), ("none", 401),
    ]  # fmt: skip
    assert lines[0] == {
        "key": writer, "client": "127.0.0.1", "method": "DELETE", "path": path, "status": 404, "shape_id": "somebody",
    }  # fmt: skip
    files = {"file": ("x.ply", small_mesh(7))}
    response = keyed.call("POST", "/v1/shapes", keyed.writer, files=files, data={"parameters": FEW})
    audited(keyed.server, "/v1/shapes", 1, response.json()["id"])
    text = keyed.server.log.read_text()
    assert all(key.split("_", 2)[2] not in text for key in (keyed.writer, keyed.reader))


def test_a_path_cannot_forge_a_log_line(keyed):
    path = '/v1/shapes/a%0AINFO unbend.audit: {"key": "forged"}'
    keyed.call("DELETE", path)
    (line,) = audited(keyed.server, '/v1/shapes/a\nINFO unbend.audit: {"key": "forged"}', 1)
    assert line["key"] == "none"


def test_a_server_requires_keys_while_any_exist_and_otherwise_serves_only_this_machine(tmp_path):
    with Server(tmp_path, workers=1, ready=False) as running, running.http() as api:
        path = "/v1/shapes/x"
        assert api.get("/v1/shapes").status_code == 200
        assert api.get("/v1/shapes", headers={"Authorization": "Bearer whatever"}).status_code == 200
        check(api.delete(path), 404, "not_found")
        assert audited(running, path, 1)[0]["key"] == "open"
        for elsewhere in ({"Host": "rebound.example"}, {"X-Forwarded-For": "203.0.113.7"}):
            check(api.get("/v1/shapes", headers=elsewhere), 401, "key_required")
        check(api.delete(path, headers={"Origin": "https://other.example"}), 403, "origin_refused")
        check(api.delete(path, headers={"Origin": "null"}), 403, "origin_refused")
        check(api.delete(path, headers={"Origin": running.url}), 404, "not_found")
        key = new_key(running.library, "write")
        check(api.get("/v1/shapes"), 401, "key_required")
        theirs = {"Authorization": f"Bearer {key}", "Origin": "https://other.example", "X-Forwarded-For": "203.0.113.7"}
        check(api.delete(path, headers=theirs), 404, "not_found")
        revoke(running.library, key)
        assert api.get("/v1/shapes").status_code == 200
        with sqlite3.connect(running.library) as connection:
            connection.execute("DROP TABLE api_keys")
        connection.close()
        response = api.get("/v1/shapes")  # if keys cannot be checked, every request is refused
        check(response, 503, "store")
        assert ALWAYS.items() <= dict(response.headers).items()


def test_an_open_server_serves_other_machines_by_allowed_host_names(tmp_path):
    settings = {"open": "true", "allowed_hosts": "unbend, Unbend.Example"}
    with Server(tmp_path, workers=1, ready=False, host="0.0.0.0", **settings) as running, running.http() as api:  # noqa: S104
        for known in ("unbend.example", "unbend:8000", "localhost:1234", "127.0.0.1", "[::1]:80", "203.0.113.7"):
            assert api.get("/v1/shapes", headers={"Host": known}).status_code == 200
        for rebound in ("other.example", "localhost.other.example", "unbend.example.com", "127.0.0.1.other.example"):
            for method, path in (("GET", "/v1/shapes"), ("DELETE", "/v1/shapes/x"), ("POST", "/v1/queries")):
                check(api.request(method, path, headers={"Host": rebound}), 403, "host_refused")
            assert api.get("/v1/livez", headers={"Host": rebound}).status_code == 200
        key = new_key(running.library)
        check(api.get("/v1/shapes"), 401, "key_required")
        theirs = {"Host": "other.example", "Authorization": f"Bearer {key}"}
        assert api.get("/v1/shapes", headers=theirs).status_code == 200


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    folder = tmp_path_factory.mktemp("limited")
    origins = "https://a.example, http://b.example:8080"
    with Server(folder, workers=1, ready=False, requests_per_minute=20, cors_origins=origins) as running:
        yield running


def test_allowed_origins_may_read_responses_and_send_preflight_requests(limited):
    with limited.http() as api:
        for origin in ("https://a.example", "http://b.example:8080"):
            response = api.get("/v1/shapes", headers={"Origin": origin})
            assert response.headers["access-control-allow-origin"] == origin
            check(api.delete("/v1/shapes/x", headers={"Origin": origin}), 404, "not_found")
        wish = {"Access-Control-Request-Method": "PATCH", "Access-Control-Request-Headers": "authorization, if-match"}
        asked = api.options("/v1/shapes/x", headers=wish | {"Origin": "https://a.example"})
        assert asked.status_code == 200
        assert "PATCH" in asked.headers["access-control-allow-methods"]
        shown = api.get("/v1/shapes", headers={"Origin": "https://a.example"})
        assert "ETag" in shown.headers["access-control-expose-headers"]
        refused = api.options("/v1/shapes/x", headers=wish | {"Origin": "https://c.example"})
        assert "access-control-allow-origin" not in refused.headers
        other = api.get("/v1/shapes", headers={"Origin": "https://c.example"})
        assert "access-control-allow-origin" not in other.headers


def test_no_origin_is_allowed_by_default(server):
    with server.http() as api:
        response = api.get("/v1/shapes", headers={"Origin": "https://a.example"})
        assert not [name for name in response.headers if name.startswith("access-control")]
        wish = {"Access-Control-Request-Method": "GET", "Origin": "https://a.example"}
        reported = api.options("/v1/shapes", headers=wish)  # lists methods, but allows no origin
        assert not [name for name in reported.headers if name.startswith("access-control")]


def until_refused(api: httpx.Client, headers: dict[str, str] | None = None) -> httpx.Response:
    """Return the first refusal; it takes more requests than the bucket holds, because the bucket refills meanwhile."""
    answers = (api.get("/v1/classes", headers=headers) for _ in range(100))
    return next(answer for answer in answers if not answer.is_success)


def test_each_caller_has_its_own_rate_limit(limited):
    with limited.http() as api:
        assert api.get("/v1/classes").status_code == 200
        response = until_refused(api)
        check(response, 429, "rate_limited")
        assert 1 <= int(response.headers["retry-after"]) <= 3
        assert api.get("/v1/livez").status_code == 200
        headers = {"Authorization": f"Bearer {new_key(limited.library)}"}
        assert api.get("/v1/classes", headers=headers).status_code == 200
        until_refused(api, headers)
        others = {"Authorization": f"Bearer {new_key(limited.library)}"}
        assert api.get("/v1/classes", headers=others).status_code == 200
        with Client(limited.url, headers["Authorization"].split()[1]) as client:
            assert client.labels() == {}  # the client waits and retries


def test_every_response_has_security_headers(server):
    with server.http() as api:
        for path, status in [("/v1/shapes", 200), ("/v1/shapes/x", 404), ("/v1/map?limit=0", 422), ("/nothing", 404)]:
            response = api.get(path)
            assert response.status_code == status
            assert ALWAYS.items() <= dict(response.headers).items()
            assert response.headers["content-security-policy"] == CLOSED
            assert response.headers.get("cache-control") == ("no-store" if path.startswith("/v1/") else None)
        refused = post_mesh(api, b"")
        assert ALWAYS.items() <= dict(refused.headers).items()


@pytest.mark.parametrize("page", ["/docs", "/docs/oauth2-redirect", "/redoc"])
def test_a_documentation_page_may_run_only_its_own_scripts(server, page):
    with server.http() as api:
        response = api.get(page)
    assert ALWAYS.items() <= dict(response.headers).items()
    policy = dict(part.split(" ", 1) for part in response.headers["content-security-policy"].split("; "))
    inline = re.findall(r"<script>(.*?)</script>", response.text, re.DOTALL)
    assert bool(inline) == (page != "/redoc")
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in inline]
    assert policy["script-src"].split() == ["'self'", *(f"'sha256-{digest}'" for digest in hashes)]
    assert (policy["default-src"], policy["frame-ancestors"]) == ("'none'", "'none'")


def test_a_request_within_the_process_needs_a_key_only_if_keys_exist(tmp_path):
    path = str(tmp_path / "inside.db")
    app = create_app(Settings(library=path, workers=1))

    async def statuses() -> list[int]:
        inside = httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://inside")
        async with app.router.lifespan_context(app), inside as client:
            first = await client.get("/v1/shapes")
            with Library(path) as library:
                library.keys.create("first", "read")
            return [first.status_code, (await client.get("/v1/shapes")).status_code]

    assert asyncio.run(statuses()) == [200, 401]
