"""The store: its schema, its migrations, and invalid paths and URLs."""

from __future__ import annotations

import asyncio
import hashlib
import sqlite3
import time
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from sqlalchemy import Connection, MetaData, create_engine, inspect
from sqlalchemy.exc import IntegrityError

from tests.support.server import small_mesh
from unbend import Library, MeshPolicy, Parameters, Signature, compute_signature, read_mesh
from unbend import library as package
from unbend.errors import ParameterError, StoreError, StoreVersionError
from unbend.jobs.runner import JobRunner
from unbend.library.packing import pack_signature, pack_vector
from unbend.library.requests import ShapeRequest, Upload
from unbend.library.storage.schema import metadata

FEW = Parameters(samples=40)
KEEP = MeshPolicy(seams="keep")  # the policy of all meshes before stitching existed


def is_ours(name: str | None, kind: str, _parents: object) -> bool:
    """Return whether something belongs to the schema of each database: PostgreSQL also has the queue of a cluster."""
    others = ("procrastinate_", "queue_migrations", "request_rates")
    return kind != "table" or not str(name).startswith(others)


def check_schema(connection: Connection) -> None:
    """Check that every table matches the declarations of the code."""
    # PostgreSQL cannot compare defaults of the type JSON.
    compared = connection.dialect.name == "sqlite"
    ours = {"compare_type": True, "compare_server_default": compared, "include_name": is_ours}
    context = MigrationContext.configure(connection, opts=ours)
    assert compare_metadata(context, metadata) == []
    seen = inspect(connection)
    for table in metadata.sorted_tables:
        expected = {tuple(key.column_keys) for key in table.foreign_key_constraints}
        assert {tuple(key["constrained_columns"]) for key in seen.get_foreign_keys(table.name)} == expected
        if connection.dialect.name != "sqlite":
            continue
        text = connection.exec_driver_sql("SELECT sql FROM sqlite_master WHERE name = ?", (table.name,)).scalar()
        assert ("AUTOINCREMENT" in text) == table.dialect_options["sqlite"]["autoincrement"]


def migrate(connection: Connection, move, revision: str) -> None:
    """Move a database to a revision, with `command.upgrade` or `command.downgrade`."""
    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(Path(package.__file__).parent / "migrations"))
    config.set_main_option("path_separator", "os")
    move(config, revision)


def test_migrations_create_the_schema_that_the_code_declares(library):
    with library.store.read() as connection:
        check_schema(connection)


def test_a_library_in_postgresql_can_be_downgraded_and_upgraded_again(postgres_url):
    made = create_engine(postgres_url)
    with made.begin() as connection:
        migrate(connection, command.downgrade, "0010")
        assert "request_rates" not in inspect(connection).get_table_names()
    made.dispose()
    with Library(postgres_url) as library:
        library.add(small_mesh(0), parameters=FEW)
        with library.store.read() as connection:
            check_schema(connection)


def old_library(path: Path) -> None:
    """Create a database of the first schema with a stored shape, its job, and a queued job."""
    made = create_engine(f"sqlite:///{path}")
    with made.begin() as connection:
        migrate(connection, command.upgrade, "0001")
        tables = MetaData()
        tables.reflect(connection)

        def add(table: str, **values: object) -> None:
            connection.execute(tables.tables[table].insert().values(**values))

        stored, waiting = small_mesh(0), small_mesh(1)
        for data in (stored, waiting):
            add("meshes", sha256=hashlib.sha256(data).hexdigest(), size=len(data), data=data)
        surface = read_mesh(stored)
        signature = compute_signature(surface, FEW)
        key = {"mesh_sha256": hashlib.sha256(stored).hexdigest(), "parameters": FEW.to_json()}
        add("signatures", id=7, **key, **about(signature), report=surface.report.as_dict(), area=surface.area)
        for measure, vector in signature.descriptors.items():
            add("descriptors", signature_id=7, measure=measure, vector=pack_vector(vector))
        shape = {"name": "ring", "label": "torus", "metadata": {"n": 1}}
        add("shapes", seq=9, id="shape", **shape, signature_id=7, created_at=time.time())
        job = {"kind": "shape", "attempts": 1, "restarts": 0, "file_type": "ply", "created_at": time.time()}
        add("jobs", seq=4, id="done", **job, **key, state="succeeded", stage="done", progress=1.0, request=shape)
        key["mesh_sha256"] = hashlib.sha256(waiting).hexdigest()
        add("jobs", seq=5, id="waits", **job, **key, state="queued", stage="queued", progress=0.0, request=shape)
    made.dispose()


def about(signature: Signature) -> dict[str, object]:
    return {"version": signature.version, "stress": signature.stress, "payload": pack_signature(signature)}


def test_a_library_of_the_first_schema_keeps_and_recognises_its_shapes(tmp_path):
    old_library(tmp_path / "a.db")
    with Library(str(tmp_path / "a.db")) as library:
        with library.store.read() as connection:
            check_schema(connection)
            assert connection.exec_driver_sql("PRAGMA foreign_key_check").all() == []
        kept = library.get("shape")
        assert (kept.name, kept.label, kept.metadata, kept.seq) == ("ring", "torus", {"n": 1}, 9)
        assert (kept.parameters, kept.policy) == (FEW, KEEP)
        assert library.mesh("shape") == small_mesh(0)
        assert library.add(small_mesh(0), parameters=FEW, policy=KEEP) == kept
        (match,) = library.nearest(library.signature("shape"))
        assert (match.id, match.distance) == ("shape", 0.0)
        assert asyncio.run(submitted(library, small_mesh(1))).seq == 6
        assert asyncio.run(submitted(library, small_mesh(0))) == kept
        library.remove("shape")
        with library.store.read() as connection:
            assert connection.exec_driver_sql("SELECT count(*) FROM descriptors").scalar() == 0
        assert library.add(small_mesh(0), parameters=FEW).seq == 10


async def submitted(library: Library, data: bytes):
    """Return the answer to an upload of a runner that was not started."""
    runner = JobRunner(library, workers=1)
    try:
        return await runner.submit_shape(Upload(data, "ply", FEW, KEEP), ShapeRequest("a"))
    finally:
        await runner.stop()


def test_a_library_can_be_downgraded_to_the_first_schema_and_upgraded_again(tmp_path):
    with Library(str(tmp_path / "a.db")) as library:
        record = library.add(small_mesh(0), parameters=FEW, policy=KEEP)
    made = create_engine(f"sqlite:///{tmp_path / 'a.db'}")  # a plain engine does not enforce foreign keys
    with made.begin() as connection:
        migrate(connection, command.downgrade, "0001")
        columns = {column["name"] for column in inspect(connection).get_columns("signatures")}
    made.dispose()
    assert "policy" not in columns
    with Library(str(tmp_path / "a.db")) as library:
        assert library.add(small_mesh(0), parameters=FEW, policy=KEEP) == record


def test_a_library_without_revisions_keeps_its_shapes_and_then_tracks_changes(tmp_path):
    path = tmp_path / "a.db"
    with Library(str(path)) as library:
        kept = [library.add(small_mesh(number), label="torus", parameters=FEW) for number in range(3)]
        gone = library.add(small_mesh(3), parameters=FEW)
        library.remove(gone.id)
        ranking = library.rank(kept[0].id)
    made = create_engine(f"sqlite:///{path}")
    with made.begin() as connection:
        migrate(connection, command.downgrade, "0002")
        seen = inspect(connection)
        assert "changed" not in {column["name"] for column in seen.get_columns("shapes")}
        assert "removals" not in seen.get_table_names()
    made.dispose()
    with Library(str(path)) as library:
        with library.store.read() as connection:
            check_schema(connection)
        assert library.page().items == kept
        assert library.rank(kept[0].id) == ranking
        library.change(kept[1].id, label="ring")
        assert {match.id: match.label for match in library.nearest(kept[0].id)} == {
            kept[1].id: "ring", kept[2].id: "torus",
        }  # fmt: skip
        assert {match.label for match in library.classify(kept[0].id)} == {"ring", "torus"}
        library.remove(kept[1].id)
        assert [match.id for match in library.nearest(kept[0].id)] == [kept[2].id]
        assert library.add(small_mesh(3), parameters=FEW).seq > gone.seq


def test_policies_without_smoothing_still_identify_their_shapes(tmp_path):
    policies = [
        KEEP,
        MeshPolicy(components="bridge", max_vertices=50, seams="keep"),
        MeshPolicy(smooth=3, seams="keep"),
    ]
    path = tmp_path / "a.db"
    with Library(str(path)) as library:
        records = [library.add(small_mesh(0), parameters=FEW, policy=policy) for policy in policies]
    made = create_engine(f"sqlite:///{path}")
    with made.begin() as connection:
        migrate(connection, command.downgrade, "0003")
        stored = connection.exec_driver_sql("SELECT policy FROM signatures ORDER BY id").scalars().all()
    made.dispose()
    assert stored == [
        '{"components":"largest","max_vertices":null}',
        '{"components":"bridge","max_vertices":50}',
        '{"components":"largest","max_vertices":null,"smooth":3}',
    ]
    with Library(str(path)) as library:
        assert [library.add(small_mesh(0), parameters=FEW, policy=policy) for policy in policies] == records
        assert len(library) == len(records)


def test_a_library_without_the_table_of_keys_can_create_keys_after_the_upgrade(tmp_path):
    path = tmp_path / "a.db"
    with Library(str(path)) as library:
        record = library.add(small_mesh(0), parameters=FEW)
        library.keys.create("lost on the way back", "write")
    made = create_engine(f"sqlite:///{path}")
    with made.begin() as connection:
        migrate(connection, command.downgrade, "0004")
        assert "api_keys" not in inspect(connection).get_table_names()
    made.dispose()
    with Library(str(path)) as library:
        assert library.page().items == [record]
        with library.store.read() as connection:
            check_schema(connection)
        assert library.keys.all() == []
        assert not library.keys.are_required()
        made_now, text = library.keys.create("new", "read")
        assert library.keys.find(text) == made_now


def test_foreign_keys_are_enforced_after_the_migration(tmp_path):
    with Library(str(tmp_path / "a.db")) as library:
        library.add(small_mesh(0), parameters=FEW)
        with pytest.raises(IntegrityError, match="FOREIGN KEY"), library.store.write() as connection:
            connection.exec_driver_sql("DELETE FROM meshes")


def test_a_sequence_number_is_never_reused(tmp_path):
    with Library(str(tmp_path / "a.db")) as library:
        first = library.add(small_mesh(0), parameters=FEW)
        library.remove(first.id)
        assert library.add(small_mesh(1), parameters=FEW).seq > first.seq


def test_a_reader_keeps_its_snapshot_while_the_store_is_written(tmp_path):
    with Library(str(tmp_path / "a.db")) as library, library.store.read() as connection:
        connection.exec_driver_sql("SELECT count(*) FROM shapes").scalar()
        library.add(small_mesh(0), parameters=FEW)
        assert connection.exec_driver_sql("SELECT count(*) FROM shapes").scalar() == 0
        assert len(library) == 1


def test_an_error_rolls_a_change_back_completely(tmp_path):
    class Stop(Exception):  # noqa: N818
        pass

    with Library(str(tmp_path / "a.db")) as library:
        record = library.add(small_mesh(0), parameters=FEW)

        def half() -> None:
            with library.store.write() as connection:
                connection.exec_driver_sql("UPDATE shapes SET name = 'half done'")
                raise Stop

        with pytest.raises(Stop):
            half()
        assert library.get(record.id) == record


def test_a_store_of_a_later_version_is_refused_unchanged(tmp_path):
    path = tmp_path / "a.db"
    with Library(str(path)) as library:
        library.add(small_mesh(0), parameters=FEW)
    with sqlite3.connect(path) as connection:
        ((ours,),) = connection.execute("SELECT version_num FROM alembic_version").fetchall()
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    connection.close()
    with pytest.raises(StoreVersionError, match="later version"):
        Library(str(path))
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT version_num FROM alembic_version").fetchall() == [("9999",)]
        assert connection.execute("SELECT count(*) FROM shapes").fetchall() == [(1,)]
        connection.execute("UPDATE alembic_version SET version_num = ?", (ours,))
    connection.close()
    with Library(str(path)) as library:
        assert len(library) == 1


def test_a_path_in_a_missing_folder_is_a_store_error(tmp_path):
    with pytest.raises(StoreError, match="cannot be opened"):
        Library(str(tmp_path / "nowhere" / "a.db"))


def test_a_folder_in_place_of_a_file_is_a_store_error(tmp_path):
    with pytest.raises(StoreError, match="cannot be opened"):
        Library(str(tmp_path))


def test_a_file_that_is_not_a_database_is_a_store_error_and_stays_unchanged(tmp_path):
    path = tmp_path / "letter.txt"
    path.write_bytes(b"Dear reader, this is no database at all. " * 100)
    before = path.read_bytes()
    with pytest.raises(StoreError, match="cannot be opened"):
        Library(str(path))
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "url", ["://nothing", "nosuchdatabase://host/name", "sqlite+nosuchdriver:///a.db", "http://host/x"]
)
def test_an_unsupported_database_url_is_refused(url):
    with pytest.raises(ParameterError):
        Library(url)


def test_the_message_about_an_invalid_url_hides_its_password():
    with pytest.raises(ParameterError) as caught:
        Library("nosuchdatabase://user:hunter2@host/name")
    assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize("name", ["with space.db", "100%.db", "what?.db", "näme.db", "a#b.db"])
def test_a_library_can_have_any_file_name(tmp_path, name):
    with Library(str(tmp_path / name)) as library:
        library.add(small_mesh(0), parameters=FEW)
    assert (tmp_path / name).is_file()


def test_a_closed_library_is_a_single_file(tmp_path):
    with Library(str(tmp_path / "a.db")) as library:
        library.add(small_mesh(0), parameters=FEW)
    assert [path.name for path in tmp_path.iterdir()] == ["a.db"]
