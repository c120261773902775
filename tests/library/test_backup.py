"""Backups of libraries in use, and restoring backups into libraries in use."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.server import Server, ended, post_mesh, small_mesh, stored, without_settings
from tests.support.store import PARAMETERS, add, insert, signature
from unbend import Library, Parameters
from unbend.errors import BackupError, ParameterError, StoreError, StoreVersionError
from unbend.library import job_rows, shape_rows
from unbend.library.backups import backup as module
from unbend.library.backups.backup import backup, check_backup, restore
from unbend.library.requests import ShapeRequest, Upload
from unbend.library.storage.database import revisions

DATABASES = ("sqlite",)  # the only one with a file

RELEASED = Path(__file__).parent / "released"


def contents(path: Path) -> dict[str, list[tuple]]:
    """Return every row of every table, except the epoch."""
    with closing(sqlite3.connect(path)) as connection:
        names = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        tables = {
            name: connection.execute(f"SELECT * FROM {name} ORDER BY 1, 2").fetchall()  # noqa: S608
            for name in names
            if name not in {"library_state", "alembic_version"}
        }
        return tables | {"revision": connection.execute("SELECT revision FROM library_state").fetchall()}


def names(path: Path) -> list[str]:
    with Library(str(path)) as library:
        return [shape.name for shape in library.page(limit=500).items]


def released(path: Path, revision: str) -> Path:
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript((RELEASED / f"{revision}.sql").read_text(encoding="utf-8"))
    return path


def enqueue(library: Library, data: bytes, name: str) -> str:
    key = Upload(data, "off", PARAMETERS).key
    with library.store.write() as connection:
        shape_rows.put_mesh(connection, key.sha256, data)
        return job_rows.enqueue(
            connection, job_id=job_rows.new_id(), key=key, file_type="ply", request=ShapeRequest(name)
        ).id


def make_key(library: Library, name: str) -> tuple[str, str]:
    record, text = library.keys.create(name, "write")
    return record.id, text


def run(code: str, *arguments: object) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], env=without_settings())


def test_a_backup_is_a_complete_library(library, path, tmp_path):
    add(library, b"some bytes", "cat", "cats", {"n": 1}, vector=(1, 2, 3))
    enqueue(library, b"others", "waiting")
    make_key(library, "owner")
    path.chmod(0o640)
    made = library.backup(tmp_path / "copy.db")
    assert (made.path, made.shapes, made.size) == (tmp_path / "copy.db", 1, (tmp_path / "copy.db").stat().st_size)
    assert contents(tmp_path / "copy.db") == contents(path)
    assert (tmp_path / "copy.db").stat().st_mode & 0o777 == 0o640
    with Library(str(tmp_path / "copy.db")) as copy:
        assert copy.page().items == library.page().items
        assert copy.rank(signature((1, 2, 3)), measure="moments") == library.rank(
            signature((1, 2, 3)), measure="moments"
        )
    assert sorted(file.name for file in tmp_path.iterdir() if not file.name.startswith("library.db")) == ["copy.db"]


WRITER = """
import itertools, sys
from sqlalchemy import update
from unbend import Library
from unbend.library.storage.schema import shapes
with Library(sys.argv[1]) as library:
    for number in itertools.count():
        with library.store.write() as connection:
            for seq in (1, 200):
                connection.execute(update(shapes).where(shapes.c.seq == seq).values(name=str(number)))
        if number == 0:
            print("writing", flush=True)
"""


def test_a_backup_is_consistent_while_another_process_writes(library, path, tmp_path):
    with library.store.write() as connection:
        for number in range(200):  # so many that the first and the last are far apart in the file
            insert(connection, b"%d" % number * 2000, str(number))
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, env=without_settings())
    seen = set()
    try:
        assert writer.stdout.readline() == b"writing\n"
        for _ in range(5):
            backup(str(path), tmp_path / "copy.db", overwrite=True)
            first, *_, last = names(tmp_path / "copy.db")
            assert first == last
            seen.add(first)
        assert writer.poll() is None
    finally:
        writer.kill()
        writer.wait()
        writer.stdout.close()
    assert len(seen) > 1  # the other process wrote between the backups


def test_a_backup_does_not_migrate_a_library_of_an_older_schema(tmp_path):
    released(tmp_path / "old.db", "0002")
    assert backup(str(tmp_path / "old.db"), tmp_path / "copy.db").revision == "0002"
    assert contents(tmp_path / "copy.db") == contents(tmp_path / "old.db")


def test_a_backup_does_not_overwrite_other_files_or_its_own_library(library, path, tmp_path):
    add(library, b"x", "new")
    taken = tmp_path / "taken.db"
    taken.write_bytes(b"something")
    with pytest.raises(ParameterError, match=r"taken\.db exists already"):
        library.backup(taken)
    assert taken.read_bytes() == b"something"
    for overwrite in (False, True):
        with pytest.raises(ParameterError, match="the library itself"):
            library.backup(path, overwrite=overwrite)
        with pytest.raises(ParameterError, match="exists already"):
            library.backup(tmp_path, overwrite=overwrite)
    library.backup(taken, overwrite=True)
    assert names(taken) == ["new"]


def test_a_backup_does_not_replace_a_library_in_use(library, tmp_path):
    other = tmp_path / "other.db"
    with Library(str(other)) as opened:
        add(opened, b"y", "other")
        with pytest.raises(ParameterError, match=r"other\.db-\w+ exists"):
            library.backup(other, overwrite=True)
        assert len(opened) == 1


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("{new}/nowhere.db", "no library at"),
        ("sqlite://", "in memory"),
        ("postgresql://user:secret@host/shapes", "in PostgreSQL, not in an SQLite file: use pg_dump"),
        ("postgresql+psycopg://user:secret@host/shapes", "in PostgreSQL, not in an SQLite file: use pg_dump"),
    ],
)
def test_a_backup_of_anything_but_a_library_file_is_refused(tmp_path, url, words):
    with pytest.raises(ParameterError, match=words) as caught:
        backup(url.format(new=tmp_path), tmp_path / "copy.db")
    assert "secret" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_backup_into_a_missing_folder_is_refused(library, tmp_path):
    with pytest.raises(ParameterError, match="no folder"):
        library.backup(tmp_path / "nowhere/copy.db")


def damaged(path: Path) -> Path:
    """Overwrite the index of labels; reading all shapes does not reveal this damage."""
    with closing(sqlite3.connect(path)) as connection:
        (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'ix_shapes_label_seq'").fetchone()
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    with path.open("r+b") as file:
        file.seek((page - 1) * size + 100)
        file.write(b"\xff" * (size - 100))
    return path


def test_a_damaged_backup_is_refused_and_overwrites_nothing(library, path, tmp_path):
    with library.store.write() as connection:
        for number in range(20):
            insert(connection, b"%d" % number, str(number), "label")
    good = library.backup(tmp_path / "good.db")
    before = good.path.read_bytes()
    library.close()
    bad = damaged(path)
    with pytest.raises(BackupError, match="damaged"):
        check_backup(bad)
    for target in (good.path, tmp_path / "empty.db"):
        with pytest.raises(StoreError):
            restore(bad, str(target), overwrite=True)
    assert good.path.read_bytes() == before
    assert not (tmp_path / "empty.db").exists()


def test_restoring_a_file_that_is_no_backup_is_refused(library, tmp_path):
    add(library, b"x", "kept")
    (tmp_path / "letter.txt").write_bytes(b"Dear reader, " * 500)
    (tmp_path / "nothing").write_bytes(b"")
    with closing(sqlite3.connect(tmp_path / "others.db")) as connection:
        connection.execute("CREATE TABLE shapes (id)")
    for name in ("letter.txt", "nothing", "others.db"):
        with pytest.raises(BackupError, match="not a library"):
            restore(tmp_path / name, library.url, overwrite=True)
    for name in ("nowhere", "."):
        with pytest.raises(ParameterError, match="no file"):
            restore(tmp_path / name, library.url, overwrite=True)
    with pytest.raises(ParameterError, match="the library itself"):
        restore(library.url, library.url, overwrite=True)
    assert [shape.name for shape in library.page().items] == ["kept"]


def test_a_backup_of_a_later_version_is_refused(library, tmp_path):
    add(library, b"x", "kept")
    later = library.backup(tmp_path / "later.db").path
    with closing(sqlite3.connect(later)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    before = later.read_bytes()
    with pytest.raises(StoreVersionError, match="later version"):
        restore(later, library.url, overwrite=True)
    assert later.read_bytes() == before
    assert [shape.name for shape in library.page().items] == ["kept"]


def test_a_restored_library_equals_its_backup(library, path, tmp_path):
    add(library, b"x", "first", "a", {"n": 1})
    copy = library.backup(tmp_path / "copy.db").path
    bytes_before, before = copy.read_bytes(), contents(copy)
    add(library, b"y", "second")
    with pytest.raises(ParameterError, match="would be replaced"):
        restore(copy, str(path))
    assert len(library) == 2
    assert restore(copy, str(path), overwrite=True).shapes == 1
    assert contents(path) == before
    assert restore(copy, str(tmp_path / "new.db")).path == tmp_path / "new.db"
    assert contents(tmp_path / "new.db") == before
    assert copy.read_bytes() == bytes_before
    assert not list(tmp_path.glob("*.part*")) + list(tmp_path.glob(".*"))
    assert add(library, b"z", "third").name == "third"
    check_backup(path)


def test_an_older_backup_is_migrated(tmp_path, library):
    restore(released(tmp_path / "old.db", "0001"), library.url, overwrite=True)
    assert sorted(shape.name for shape in library.page().items) == ["flät/=1", "uploaded"]
    assert check_backup(Path(library.url)).revision == max(revisions())


def moments_of(library: Library) -> list[tuple[str, float]]:
    ranking = library.rank(signature(), measure="moments", k=100)
    return [(match.name, match.distance) for match in ranking.shapes]


@pytest.mark.parametrize("more", [0, 1, 5], ids=["a lower revision", "the same revision", "a higher revision"])
def test_open_libraries_search_the_restored_shapes_whatever_the_revision(library, path, tmp_path, more):
    """A cached index must not mistake a revision of the restored history for a revision of its own history."""
    with Library(str(tmp_path / "other.db")) as other:
        for number in range(2 + more):
            add(other, b"other %d" % number, f"other {number}", vector=(number, 0, 0))
        copy = other.backup(tmp_path / "copy.db").path
        expected = moments_of(other)
    with Library(str(path)) as second:
        for number in range(3):
            add(library, b"%d" % number, str(number), vector=(10 + number, 0, 0))
        assert len(moments_of(library)) == len(moments_of(second)) == 3
        restore(copy, str(path), overwrite=True)
        assert moments_of(library) == expected
        add(library, b"late", "late", vector=(50, 0, 0))
        assert moments_of(second) == moments_of(library) == [*expected, ("late", 50.0)]


def test_a_restore_by_another_library_is_noticed_even_if_the_revision_is_equal(library, path, tmp_path):
    add(library, b"one", "one", vector=(1, 0, 0))
    copy = library.backup(tmp_path / "copy.db").path
    add(library, b"two", "two", vector=(2, 0, 0))
    assert len(moments_of(library)) == 2
    with Library(str(path)) as other:
        restore(copy, str(path), overwrite=True)
        add(other, b"three", "three", vector=(3, 0, 0))  # makes the revision and the last seq equal to the old ones
    assert moments_of(library) == [("one", 1.0), ("three", 3.0)]


def test_readers_keep_their_snapshot_during_a_restore(library, path, tmp_path):
    add(library, b"one", "one")
    copy = library.backup(tmp_path / "copy.db").path
    add(library, b"two", "two")
    with library.store.read() as connection:
        assert shape_rows.count_shapes(connection) == 2
        restore(copy, str(path), overwrite=True)
        assert shape_rows.count_shapes(connection) == 2
        assert shape_rows.get_file(
            connection, shape_rows.list_shapes(connection, label=None, cursor=None, limit=9).items[1].sha256
        )
    assert len(library) == 1


def test_a_restore_waits_for_a_writer(library, path, tmp_path):
    copy = library.backup(tmp_path / "copy.db").path
    with library.store.write() as connection:
        insert(connection, b"x", "lost with the restore")
        thread = threading.Thread(target=restore, args=(copy, str(path)), kwargs={"overwrite": True})
        thread.start()
        thread.join(1.0)
        assert thread.is_alive()
    thread.join(60)
    assert not thread.is_alive()
    assert len(library) == 0


def test_a_restore_fails_if_a_writer_takes_too_long(library, path, tmp_path, monkeypatch):
    copy = library.backup(tmp_path / "copy.db").path
    monkeypatch.setattr("unbend.library.storage.sqlite._BUSY_SECONDS", 0.1)
    with library.store.write() as connection:
        insert(connection, b"x", "kept")
        with pytest.raises(StoreError, match="locked"):
            restore(copy, str(path), overwrite=True)
    assert [shape.name for shape in library.page().items] == ["kept"]


def test_a_backup_with_another_page_size_can_be_restored(library, path, tmp_path):
    add(library, b"x" * 9000, "one")
    copy = library.backup(tmp_path / "copy.db").path
    with closing(sqlite3.connect(copy)) as connection:
        connection.execute("PRAGMA page_size = 16384")
        connection.execute("VACUUM")
    library.remove(library.page().items[0].id)
    restore(copy, str(path), overwrite=True)
    assert [shape.name for shape in library.page().items] == ["one"]
    check_backup(path)


def test_running_jobs_of_a_backup_are_queued_after_the_restore(library, tmp_path):
    ids = [enqueue(library, b"%d" % number, str(number)) for number in range(2)]
    with library.store.write() as connection:
        assert job_rows.claim(connection).id == ids[0]
    copy = library.backup(tmp_path / "copy.db").path
    restore(copy, str(tmp_path / "new.db"))
    with Library(str(tmp_path / "new.db")) as restored, restored.store.write() as connection:
        jobs = [job_rows.claim(connection) for _ in range(3)]
    assert [job and (job.id, job.attempts, job.restarts) for job in jobs] == [(ids[0], 1, 0), (ids[1], 1, 0), None]


def test_a_restore_keeps_the_keys_of_the_library(library, path, tmp_path):
    old_id, old = make_key(library, "revoked since")
    _, kept = make_key(library, "kept")
    copy = library.backup(tmp_path / "copy.db").path
    library.keys.revoke(old_id)
    _, new = make_key(library, "made since")
    restore(copy, str(path), overwrite=True)
    assert library.keys.find(old) is None
    assert library.keys.find(kept).name == "kept"
    assert library.keys.find(new).name == "made since"
    assert len(library.keys.all()) == 3


def test_a_restore_into_a_library_without_keys_takes_the_keys_of_the_backup(library, tmp_path):
    _, text = make_key(library, "owner")
    copy = library.backup(tmp_path / "copy.db").path
    with Library(str(tmp_path / "fresh.db")):
        pass
    restore(copy, str(tmp_path / "fresh.db"), overwrite=True)
    with Library(str(tmp_path / "fresh.db")) as fresh:
        assert fresh.keys.find(text).name == "owner"


def test_a_key_revoked_during_a_restore_stays_revoked(library, path, tmp_path, monkeypatch):
    key_id, text = make_key(library, "leaked")
    copy = library.backup(tmp_path / "copy.db").path
    looked = []

    def check_late(file: Path) -> module.Backup:
        looked.append(file)
        if len(looked) == 2:  # the staged copy: its keys were read, and the library is not written yet
            library.keys.revoke(key_id)
        return check_backup(file)

    monkeypatch.setattr(module, "check_backup", check_late)
    restore(copy, str(path), overwrite=True)
    assert len(looked) == 3
    assert library.keys.find(text) is None


KILLED = """
import os, signal, sys
from pathlib import Path
from unbend.library.backups import backup
steps = 0
def kill(*_):
    global steps
    steps += 1
    if steps == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)
if sys.argv[2] == "restore":
    backup._KeyCheck.__call__ = kill
    backup.restore(sys.argv[3], sys.argv[4], overwrite=True)
else:
    backup.sync = kill
    backup.backup(sys.argv[3], sys.argv[4], overwrite=True)
"""


def test_a_killed_restore_changes_nothing(library, path, tmp_path):
    add(library, b"x" * 50_000, "one")
    copy = library.backup(tmp_path / "copy.db").path
    add(library, b"y", "two")
    before = contents(path)
    assert run(KILLED, 4, "restore", copy, path).wait(60) == -signal.SIGKILL
    assert contents(path) == before
    check_backup(path)
    assert len(library) == 2
    add(library, b"z", "three")


def test_a_killed_backup_keeps_the_previous_backup(library, path, tmp_path):
    add(library, b"x", "one")
    copy = library.backup(tmp_path / "copy.db").path
    add(library, b"y", "two")
    assert run(KILLED, 1, "backup", path, copy).wait(60) == -signal.SIGKILL
    assert check_backup(copy).shapes == 1


def test_a_running_server_uses_the_restored_library(tmp_path):
    with Server(tmp_path / "server", workers=1) as server, server.http() as http:
        few = {"parameters": Parameters(samples=40).to_json()}
        first = stored(http, small_mesh(0), name="first", label="a", **few)
        query = {"shape_id": first["id"]}
        with Library(str(server.library)) as library:
            enqueue(library, small_mesh(90), "waited")  # the server notices this job at the next upload
            copy = library.backup(tmp_path / "copy.db").path
        gone = stored(http, small_mesh(1), name="second", label="b", **few)
        assert http.post("/v1/queries", json=query).json()["shapes"][0]["id"] == gone["id"]
        command = [sys.executable, "-m", "unbend", "restore", copy, "--library", server.library]
        environment = without_settings()
        refused = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert (refused.returncode, "would be replaced" in refused.stderr) == (1, True)
        subprocess.run([*command, "--force"], env=environment, check=True, capture_output=True)
        kept = http.get("/v1/shapes").json()["items"]
        assert [shape for shape in kept if shape["name"] != "waited"] == [first]  # whose job may have run by now
        assert http.get(f"/v1/shapes/{gone['id']}").status_code == 404
        assert {match["name"] for match in http.post("/v1/queries", json=query).json()["shapes"]} <= {"waited"}
        again = ended(http, post_mesh(http, small_mesh(1), name="third", **few))
        assert again["state"] == "succeeded"
        found = {shape["name"] for shape in http.get("/v1/shapes").json()["items"]}
        assert found == {"first", "waited", "third"}
        assert {match["name"] for match in http.post("/v1/queries", json=query).json()["shapes"]} == {"waited", "third"}
        assert http.get("/v1/livez").status_code == 200
    check_backup(server.library)
