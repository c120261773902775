"""The file of a library: removed, replaced, and on a disk that fills."""

from __future__ import annotations

import os
import shutil
from functools import partial

import pytest

from tests.support.disk import small_disk
from tests.support.store import add, insert
from unbend import Library
from unbend.errors import StoreFullError, StoreLostError


@pytest.fixture
def library(tmp_path):
    with Library(str(tmp_path / "library.db")) as opened:
        yield opened


def remove(path):
    path.unlink()


def rename(path):
    path.rename(path.with_suffix(".old"))


def replace(path):
    copy = path.with_suffix(".copy")
    shutil.copy(path, copy)
    copy.rename(path)


def lose_the_log(path):
    path.with_name(f"{path.name}-wal").unlink()


@pytest.mark.parametrize("harm", [remove, rename, replace, lose_the_log])
def test_a_file_that_is_not_the_one_that_was_opened_takes_and_gives_nothing(library, tmp_path, harm):
    add(library, b"one", "one")
    harm(tmp_path / "library.db")
    for call in (partial(add, library, b"two", "two"), library.page, partial(library.change, "x", {"name": "n"})):
        with pytest.raises(StoreLostError, match=r"library\.db"):
            call()


def test_a_change_to_a_file_that_is_removed_meanwhile_is_not_acknowledged(library, tmp_path):
    def change(connection):
        insert(connection, b"one", "one")
        (tmp_path / "library.db").unlink()

    with pytest.raises(StoreLostError):
        library.store.change(change)


@pytest.mark.parametrize("harm", [remove, lose_the_log])
def test_a_library_behind_a_link_is_watched_where_it_lies(tmp_path, harm):
    (tmp_path / "real").mkdir()
    (tmp_path / "link.db").symlink_to(tmp_path / "real" / "library.db")
    with Library(str(tmp_path / "link.db")) as library:
        library.disk.reserve(2**20)
        assert (tmp_path / "real" / "library.db-reserve").stat().st_size == 2**20
        add(library, b"one", "one")
        harm(tmp_path / "real" / "library.db")
        with pytest.raises(StoreLostError):
            library.page()


def test_an_upload_that_is_refused_does_not_cost_the_reserve(library, tmp_path):
    library.disk.reserve(2**20)
    with (tmp_path / "library.db-reserve").open("rb") as reserve:
        with pytest.raises(StoreFullError):
            library.store.change(lambda _: library.disk.admit_upload(2**60))
        assert os.fstat(reserve.fileno()).st_nlink == 1  # it is there, and was all the time


@pytest.fixture
def disk(tmp_path):
    """A disk of its own, of 24 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        with small_disk(folder, 24):
            yield folder
    except PermissionError:
        pytest.skip("only root can mount a disk of its own")


LARGE = 4 * 2**20


def test_a_full_disk_refuses_what_does_not_fit_and_lets_shapes_be_removed(disk):
    with Library(str(disk / "library.db")) as library:
        library.disk.reserve(6 * 2**20)
        large = add(library, bytes(LARGE), "large")
        (disk / "other").write_bytes(bytes(library.disk.free() - 6 * 2**20))  # somebody else fills what is left
        with pytest.raises(StoreFullError):
            library.disk.admit_upload(LARGE)
        with pytest.raises(StoreFullError), library.store.write() as connection:
            insert(connection, bytes(3 * LARGE), "more")
        library.remove(large.id)  # overwrites as much as it takes away
        assert len(library) == 0
        library.disk.admit_upload(LARGE // 2)  # where the shape was
        add(library, bytes(LARGE // 2), "in its place")


def test_jobs_can_begin_as_long_as_uploads_are_taken(disk):
    with Library(str(disk / "library.db")) as library, (disk / "other").open("wb", buffering=0) as other:
        library.disk.reserve(6 * 2**20)

        def fill() -> None:
            for _ in range(24 * 16):
                library.disk.admit_upload(0)
                library.disk.admit_result()
                other.write(bytes(2**16))

        with pytest.raises(StoreFullError):
            fill()
        library.disk.admit_result()  # for what was taken before


def test_the_reserve_is_made_again_when_there_is_room(disk):
    with Library(str(disk / "library.db")) as library:
        library.disk.reserve(6 * 2**20)
        free = library.disk.free()
        other = disk / "other"
        other.write_bytes(bytes(free - 7 * 2**20))  # one is left
        shape = add(library, b"small", "small")
        with pytest.raises(StoreFullError):
            library.store.change(lambda connection: insert(connection, bytes(10 * 2**20), "large"))
        assert not (disk / "library.db-reserve").exists()
        other.unlink()
        library.disk.admit_upload(LARGE)
        assert (disk / "library.db-reserve").stat().st_size == 6 * 2**20
        assert library.get(shape.id).name == "small"
    assert not (disk / "library.db-reserve").exists()
