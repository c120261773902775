"""The file of a library when it is removed or replaced, and when its disk fills."""

from __future__ import annotations

import os
import shutil
from functools import partial

import pytest

from tests.support.disk import small_disk
from tests.support.store import add, insert
from unbend import Library
from unbend.errors import StoreFullError, StoreLostError

DATABASES = ("sqlite",)  # the only one with a file


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
def test_a_library_whose_file_was_removed_or_replaced_refuses_all_calls(library, tmp_path, harm):
    add(library, b"one", "one")
    harm(tmp_path / "library.db")
    for call in (partial(add, library, b"two", "two"), library.page, partial(library.change, "x", name="n")):
        with pytest.raises(StoreLostError, match=r"library\.db"):
            call()


def test_a_change_fails_if_the_file_is_removed_during_the_change(library, tmp_path):
    def change(connection):
        insert(connection, b"one", "one")
        (tmp_path / "library.db").unlink()

    with pytest.raises(StoreLostError):
        library.store.change(change)


@pytest.mark.parametrize("harm", [remove, lose_the_log])
def test_a_library_opened_by_a_link_is_checked_at_its_real_path(tmp_path, harm):
    (tmp_path / "real").mkdir()
    (tmp_path / "link.db").symlink_to(tmp_path / "real" / "library.db")
    with Library(str(tmp_path / "link.db")) as library:
        library.disk.reserve(2**20)
        assert (tmp_path / "real" / "library.db-reserve").stat().st_size == 2**20
        add(library, b"one", "one")
        harm(tmp_path / "real" / "library.db")
        with pytest.raises(StoreLostError):
            library.page()


def test_a_refused_upload_does_not_use_the_reserved_space(library, tmp_path):
    library.disk.reserve(2**20)
    with (tmp_path / "library.db-reserve").open("rb") as reserve:
        with pytest.raises(StoreFullError):
            library.store.change(lambda _: library.disk.admit_upload(2**60))
        assert os.fstat(reserve.fileno()).st_nlink == 1  # the file was never removed


@pytest.fixture
def disk(tmp_path):
    """The folder of a mounted disk of 24 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        with small_disk(folder, 24):
            yield folder
    except PermissionError:
        pytest.skip("only root can mount a disk of its own")


LARGE = 4 * 2**20


def test_a_full_disk_refuses_large_shapes_but_allows_removals(disk):
    with Library(str(disk / "library.db")) as library:
        library.disk.reserve(6 * 2**20)
        large = add(library, bytes(LARGE), "large")
        (disk / "other").write_bytes(bytes(library.disk.free() - 6 * 2**20))  # another program fills the rest
        with pytest.raises(StoreFullError):
            library.disk.admit_upload(LARGE)
        with pytest.raises(StoreFullError), library.store.write() as connection:
            insert(connection, bytes(3 * LARGE), "more")
        library.remove(large.id)  # needs space in the log to overwrite the content
        assert len(library) == 0
        library.disk.admit_upload(LARGE // 2)  # fits into the space of the removed shape
        add(library, bytes(LARGE // 2), "in its place")


def test_jobs_can_start_as_long_as_uploads_are_accepted(disk):
    with Library(str(disk / "library.db")) as library, (disk / "other").open("wb", buffering=0) as other:
        library.disk.reserve(6 * 2**20)

        def fill() -> None:
            for _ in range(24 * 16):
                library.disk.admit_upload(0)
                library.disk.admit_result()
                other.write(bytes(2**16))

        with pytest.raises(StoreFullError):
            fill()
        library.disk.admit_result()  # there is still space for results of accepted uploads


def test_the_reserved_space_is_restored_when_the_disk_has_space(disk):
    with Library(str(disk / "library.db")) as library:
        library.disk.reserve(6 * 2**20)
        free = library.disk.free()
        other = disk / "other"
        other.write_bytes(bytes(free - 7 * 2**20))  # leaves one megabyte beyond the reserve
        shape = add(library, b"small", "small")
        with pytest.raises(StoreFullError):
            library.store.change(lambda connection: insert(connection, bytes(10 * 2**20), "large"))
        assert not (disk / "library.db-reserve").exists()
        other.unlink()
        library.disk.admit_upload(LARGE)
        assert (disk / "library.db-reserve").stat().st_size == 6 * 2**20
        assert library.get(shape.id).name == "small"
    assert not (disk / "library.db-reserve").exists()
