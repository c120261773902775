"""Backups that a server makes: at intervals, and on request over HTTP."""

from __future__ import annotations

import json
import os
import time

import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, small_mesh, stored
from unbend import Library
from unbend.api.server.scheduled_backups import backups_in
from unbend.library.backups.backup import restore, verify

FEW = json.dumps(SAMPLES)
PATIENCE = 60.0


def until(reached) -> None:
    end = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.1)


def test_a_backup_over_http_is_valid_and_leaves_no_temporary_file(tmp_path):
    with Server(tmp_path, workers=1) as server, server.http() as http:
        shape = stored(http, small_mesh(1), parameters=FEW, label="ring")
        response = http.post("/v1/backups")
        assert response.status_code == 200
        assert response.headers["content-type"] == "application/vnd.sqlite3"
        assert int(response.headers["content-length"]) == len(response.content)
        (tmp_path / "backup.db").write_bytes(response.content)
        until(lambda: not list(server.temporary.glob("unbend-backup-*")))
    assert verify(tmp_path / "backup.db").shapes == 1
    restore(tmp_path / "backup.db", str(tmp_path / "other.db"))
    with Library(str(tmp_path / "other.db")) as library:
        assert library.get(shape["id"]).label == "ring"
        assert library.mesh(shape["id"]) == small_mesh(1)


def test_a_backup_over_http_needs_a_write_key(tmp_path):
    with Library(str(tmp_path / "library.db")) as library:
        read, write = (library.keys.create(scope, scope)[1] for scope in ("read", "write"))
    with Server(tmp_path, workers=1, ready=False) as server, server.http() as http:
        check(http.post("/v1/backups"), 401, "key_required")
        check(http.post("/v1/backups", headers={"Authorization": f"Bearer {read}"}), 403, "scope_insufficient")
        assert http.post("/v1/backups", headers={"Authorization": f"Bearer {write}"}).status_code == 200


def test_scheduled_backups_keep_only_the_newest(tmp_path):
    folder = tmp_path / "backups"
    folder.mkdir()
    (folder / "unbend-20200101T000000Z.db").write_bytes(b"old")
    os.utime(folder / "unbend-20200101T000000Z.db", (0, 0))
    (folder / "mine.db").write_bytes(b"not the server's")
    settings = {"backup_folder": folder, "backup_hours": 1.5 / 3600, "backup_keep": 2}
    with Server(tmp_path, workers=1, ready=False, **settings) as server, server.http() as http:
        until(
            lambda: len(backups_in(folder)) == 2 and (folder / "unbend-20200101T000000Z.db") not in backups_in(folder)
        )
        figures = http.get("/v1/metrics").text
        assert "unbend_backup_failures_total 0.0" in figures
        assert "unbend_backup_timestamp_seconds" in figures
    for made in backups_in(folder):
        assert verify(made).shapes == 0
    assert (folder / "mine.db").read_bytes() == b"not the server's"
    before = backups_in(folder)
    with Server(tmp_path, workers=1, **settings | {"backup_hours": 24}):
        assert backups_in(folder) == before  # the last backup of the previous server is recent enough


@pytest.mark.parametrize("folder", ["nowhere"])
def test_a_server_does_not_start_if_its_backup_folder_is_missing(tmp_path, folder):
    with pytest.raises(RuntimeError, match="there is no folder"):
        Server(tmp_path, workers=1, backup_folder=tmp_path / folder)
