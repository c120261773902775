"""The store: its schema, its migrations, and paths and addresses that are none."""

from __future__ import annotations

import sqlite3

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import inspect

from server import small_mesh
from unbend import Library, Parameters
from unbend.errors import ParameterError, StoreError, StoreVersionError
from unbend.library.schema import metadata

FEW = Parameters(samples=40)


def test_migrations_make_the_schema_that_the_code_uses(tmp_path):
    with Library(str(tmp_path / "a.db")) as library, library.store.read() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "compare_server_default": True})
        assert compare_metadata(context, metadata) == []
        seen = inspect(connection)
        for table in metadata.sorted_tables:
            expected = {tuple(key.column_keys) for key in table.foreign_key_constraints}
            assert {tuple(key["constrained_columns"]) for key in seen.get_foreign_keys(table.name)} == expected


def test_a_place_in_the_order_never_comes_again(tmp_path):
    with Library(str(tmp_path / "a.db")) as library:
        first = library.add(small_mesh(0), parameters=FEW)
        library.remove(first.id)
        assert library.add(small_mesh(1), parameters=FEW).seq > first.seq


def test_a_store_survives_a_reader_while_it_is_written(tmp_path):
    with Library(str(tmp_path / "a.db")) as library, library.store.read() as connection:
        connection.exec_driver_sql("SELECT count(*) FROM shapes").scalar()
        library.add(small_mesh(0), parameters=FEW)
        assert connection.exec_driver_sql("SELECT count(*) FROM shapes").scalar() == 0
        assert len(library) == 1


def test_an_error_inside_a_change_undoes_all_of_it(tmp_path):
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


def test_a_store_of_a_later_version_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "a.db"
    with Library(str(path)) as library:
        library.add(small_mesh(0), parameters=FEW)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    connection.close()
    with pytest.raises(StoreVersionError, match="later version"):
        Library(str(path))
    with sqlite3.connect(path) as connection:
        assert connection.execute("SELECT version_num FROM alembic_version").fetchall() == [("9999",)]
        assert connection.execute("SELECT count(*) FROM shapes").fetchall() == [(1,)]
        connection.execute("UPDATE alembic_version SET version_num = '0001'")
    connection.close()
    with Library(str(path)) as library:
        assert len(library) == 1


def test_a_path_in_a_folder_that_is_not_there_is_a_store_error(tmp_path):
    with pytest.raises(StoreError, match="cannot be opened"):
        Library(str(tmp_path / "nowhere" / "a.db"))


def test_a_folder_is_a_store_error(tmp_path):
    with pytest.raises(StoreError, match="cannot be opened"):
        Library(str(tmp_path))


def test_a_file_that_is_no_database_is_a_store_error_and_stays_as_it_is(tmp_path):
    path = tmp_path / "letter.txt"
    path.write_bytes(b"Dear reader, this is no database at all. " * 100)
    before = path.read_bytes()
    with pytest.raises(StoreError, match="cannot be opened"):
        Library(str(path))
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "url", ["://nothing", "nosuchdatabase://host/name", "sqlite+nosuchdriver:///a.db", "http://host/x"]
)
def test_an_address_of_no_database_we_know_is_refused(url):
    with pytest.raises(ParameterError):
        Library(url)


def test_the_message_about_a_bad_address_does_not_tell_its_password():
    with pytest.raises(ParameterError) as caught:
        Library("nosuchdatabase://user:hunter2@host/name")
    assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize("name", ["with space.db", "100%.db", "what?.db", "näme.db", "a#b.db"])
def test_any_file_name_will_do(tmp_path, name):
    with Library(str(tmp_path / name)) as library:
        library.add(small_mesh(0), parameters=FEW)
    assert (tmp_path / name).is_file()


def test_a_closed_library_leaves_one_whole_file(tmp_path):
    with Library(str(tmp_path / "a.db")) as library:
        library.add(small_mesh(0), parameters=FEW)
    assert [path.name for path in tmp_path.iterdir()] == ["a.db"]
