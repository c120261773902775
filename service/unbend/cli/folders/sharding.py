"""The share of a folder that belongs to one shard, and the files that shards describe."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from unbend.cli.folders.files import NO_ROW, LabelledFile, LeftOut, MeshFolder, read_rows
from unbend.cli.folders.first_paths import FirstPaths
from unbend.errors import ResultsError
from unbend.library.shards.entries import SUFFIX, UNFINISHED

if TYPE_CHECKING:
    from unbend.library.shards.index import ShardIndex
    from unbend.library.shards.numbering import ShardNumber
    from unbend.library.shards.records import FileRecord

_SHARD: Final = re.compile(rf"\d+-of-\d+(\.\d+)?({re.escape(SUFFIX)}|{re.escape(UNFINISHED)})")

NO_SHARD: Final = "not a shard"
IS_UNFINISHED: Final = "an unfinished shard"
IS_DAMAGED: Final = "a damaged shard"


def path_within(path: Path, folder: Path) -> PurePosixPath:
    """Return the path of a file relative to a folder, in the same form on every machine."""
    return PurePosixPath(Path(os.path.relpath(path, folder)).as_posix())


@dataclass(frozen=True)
class ShardOfFolder:
    """The files of a folder that belong to one shard. Every other file is a matter of exactly one other shard."""

    folder: MeshFolder
    shard: ShardNumber

    @property
    def emptiness(self) -> str:
        """The error if the whole folder has no mesh; empty if only this shard has none, which is no error."""
        return "" if any(isinstance(item, LabelledFile) for item in self.folder) else self.folder.emptiness

    def __iter__(self) -> Iterator[LabelledFile | LeftOut]:
        for item in self.folder:
            if self.shard.has(path_within(item.path, self.folder.path)):
                yield item


def is_shards(path: Path) -> bool:
    """Return whether a path is a shard, or a folder that has files with the names of shards."""
    if path.is_file():
        return path.name.endswith((SUFFIX, UNFINISHED))
    try:
        return any(_SHARD.fullmatch(item.name) for item in path.iterdir())
    except OSError:  # a folder that cannot be listed is accounted for as a folder of meshes
        return False


@dataclass(frozen=True)
class ComputedFile(LabelledFile):
    """A file whose results are in a shard. Its path is relative to the folder that was computed."""

    record: FileRecord = field(kw_only=True)


class ShardFolder:
    """The files that the shards of a folder describe, each as a file to import or as left out.

    The shards are read once, and their entries are then in an index.

    Parameters
    ----------
    path : Path
        A folder of shards, or one shard.
    index : ShardIndex
        An empty index, which is filled.
    labels : Path, optional
        A file of labels, whose paths are relative to the folder that was computed.
    label_from_folder : bool, default False
    skipped : collection of Path
        Files that are not part of the folder, such as the report.
    """

    def __init__(
        self,
        path: Path,
        index: ShardIndex,
        labels: Path | None = None,
        *,
        label_from_folder: bool = False,
        skipped: Collection[Path] = (),
    ) -> None:
        self._path, self._index, self._labels, self._label_from_folder = path, index, labels, label_from_folder
        kept_out = {file.absolute() for file in (*skipped, labels) if file}
        found = sorted(path.iterdir()) if path.is_dir() else [path]
        self._left_out = [left for file in found if file.absolute() not in kept_out and (left := self._read(file))]

    @property
    def emptiness(self) -> str:
        """The error if there is no result."""
        if self._labels:
            return f"{self._labels}: no row names a file of the shards"
        return f"{self._path}: the shards have no results"

    def __iter__(self) -> Iterator[ComputedFile | LeftOut]:
        yield from self._left_out
        if self._labels is None:
            yield from map(self._recorded, self._index.files())
            return
        with FirstPaths() as named:
            for row in read_rows(self._labels, Path(), self._has):
                if isinstance(row, LeftOut):
                    yield row
                    continue
                path = _named(row.path)
                named.put(os.fsencode(path), row.path)
                for record in self._index.files(path):
                    yield ComputedFile(Path(path), row.label, row.name, row.metadata, is_row=True, record=record)
            for record in self._index.files():
                if named.find(os.fsencode(record.path)) is None:
                    yield LeftOut(Path(record.path), NO_ROW)

    def _has(self, path: Path) -> bool:
        return any(True for _ in self._index.files(_named(path)))

    def _recorded(self, record: FileRecord) -> ComputedFile:
        path = Path(record.path)
        if self._label_from_folder:
            return ComputedFile(path, record.folder, record.name, record.metadata, record=record)
        return ComputedFile(path, record.label, record.name, record.metadata, is_row=record.is_row, record=record)

    def _read(self, path: Path) -> LeftOut | None:
        """Read a shard into the index; return it as left out if it cannot be used as a whole."""
        if path.name.endswith(UNFINISHED):
            return LeftOut(
                path, IS_UNFINISHED, f"{path} is unfinished: run its `unbend compute` again, which finishes it"
            )
        if not path.name.endswith(SUFFIX):
            return LeftOut(path, NO_SHARD)
        try:
            self._index.add_shard(path)
        except ResultsError as error:
            return LeftOut(path, IS_DAMAGED, f"{error}. {error.advice}")
        return None


def _named(path: Path) -> str:
    return PurePosixPath(os.path.normpath(path)).as_posix()
