"""Backups that a server makes: at intervals, and on request over HTTP."""

from __future__ import annotations

import asyncio
import json
import os
import time

import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, small_mesh, stored
from unbend import Library
from unbend.api.server import scheduled_backups
from unbend.api.server.metrics import Metrics
from unbend.api.server.scheduled_backups import BackupPlan, ScheduledBackups, backups_in
from unbend.library.backups.backup import restore, verify

FEW = json.dumps(SAMPLES)
PATIENCE = 60.0


def until(reached) -> None:
    end = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.1)


def test_scheduled_backups_survive_a_backup_that_vanishes(tmp_path, monkeypatch):
    listed = scheduled_backups.backups_in
    monkeypatch.setattr(scheduled_backups, "_RETRY_SECONDS", 0.01)
    monkeypatch.setattr(
        scheduled_backups, "backups_in", lambda folder: listed(folder) or [folder / "unbend-removed-meanwhile.db"]
    )

    async def run(library: Library) -> None:
        backups = ScheduledBackups(library, BackupPlan(tmp_path, hours=24, keep=1), Metrics())
        backups.start()
        await asyncio.sleep(0.05)
        monkeypatch.setattr(scheduled_backups, "backups_in", listed)
        async with asyncio.timeout(PATIENCE):
            while not listed(tmp_path):
                await asyncio.sleep(0.05)
        await backups.stop()

    with Library(str(tmp_path / "a.db")) as library:
        asyncio.run(run(library))


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
