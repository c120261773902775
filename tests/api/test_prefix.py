"""The service under a path prefix of a proxy, whether or not the proxy strips the prefix."""

from __future__ import annotations

import json
import re

import pytest

from tests.support.server import SAMPLES, Server, small_mesh
from unbend.api.server.configuration import read_settings
from unbend.errors import ParameterError

FEW = json.dumps(SAMPLES)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("prefix"), workers=1, root_path="/my/shapes") as running:
        yield running


@pytest.mark.parametrize("passed_on", ["", "/my/shapes"])
def test_every_link_contains_the_proxy_prefix(server, passed_on):
    with server.http() as http:
        root = http.get(f"{passed_on}/", follow_redirects=False)
        if root.is_redirect:  # the package was installed without the page
            assert root.headers["location"] == "/my/shapes/docs"
        else:
            assert re.findall(r'(?:src|href)="([^"]+)"', root.text)
            assert all(
                each.startswith("/my/shapes/assets/") for each in re.findall(r'(?:src|href)="([^"]+)"', root.text)
            )
        page = http.get(f"{passed_on}/docs").text
        assert "/my/shapes/openapi.json" in page
        for address in re.findall(r'(?:src|href)="(/[^"]+)"', page):
            assert address.startswith("/my/shapes/"), address
            assert http.get(passed_on + address.removeprefix("/my/shapes")).status_code == 200
        document = http.get(f"{passed_on}/openapi.json").json()
        assert document["servers"] == [{"url": "/my/shapes"}]
        form = {"files": {"file": ("m.ply", small_mesh(len(passed_on)))}, "data": {"parameters": FEW}}
        accepted = http.post(f"{passed_on}/v1/shapes", **form)
        place = accepted.headers["location"]
        assert place == f"/my/shapes/v1/jobs/{accepted.json()['id']}"
        assert http.get(passed_on + place.removeprefix("/my/shapes")).status_code == 200
        assert http.get(f"{passed_on}/v1/nothing").status_code == 404


def test_a_prefixed_path_is_protected_like_an_unprefixed_one(server):
    with server.http() as http:
        for host in ("other.example",):
            response = http.get("/my/shapes/v1/shapes", headers={"Host": host})
            assert response.status_code in {401, 403}


@pytest.mark.parametrize("wrong", ["shapes", "/shapes/", "/v1", "/docs/x", "/a b", "//", "/"])
def test_an_invalid_prefix_is_refused(monkeypatch, wrong):
    monkeypatch.setenv("UNBEND_ROOT_PATH", wrong)
    with pytest.raises(ParameterError, match="UNBEND_ROOT_PATH"):
        read_settings({})
