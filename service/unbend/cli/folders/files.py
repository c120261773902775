"""Folders of meshes and their labels."""

from __future__ import annotations

import csv
import os
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from unbend.cli.folders.first_paths import FirstPaths
from unbend.errors import ParameterError
from unbend.jsons import parse_json
from unbend.mesh.formats import FORMATS
from unbend.names import MAX_TEXT, printable


@dataclass(frozen=True)
class LabelledFile:
    """A mesh file, its class, and the other data that `unbend export` wrote."""

    path: Path
    label: str | None
    """None if it has no class: the shape then keeps the class that it may have."""
    name: str | None = None
    metadata: dict[str, Any] | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    policy: dict[str, Any] = field(default_factory=dict)
    is_row: bool = False
    """Whether it comes from a file of labels."""


@dataclass(frozen=True)
class LeftOut:
    """A file that is not imported, or a row without a file."""

    path: Path
    reason: str
    fault: str = ""
    """The error, if the user asked for this file; empty otherwise."""


NO_MESH: Final = "not a mesh"
NO_ROW: Final = "a mesh without a row in the file of labels"
NO_FILE: Final = "a row without a file"
NOT_REGULAR: Final = "not a regular file"
UNREADABLE: Final = "without permission to read it"

_OBJECTS: Final = ("metadata", "parameters", "policy")
"""Columns of a file of labels that have JSON objects."""

_EXTENSIONS: Final = frozenset(f".{name}" for name in FORMATS)


@dataclass(frozen=True)
class MeshFolder:
    """The files below a folder, each as a mesh to import or as left out. Every iteration reads the folder again.

    Iterations hold only the names of one folder, and of its parents, in memory.
    """

    path: Path
    labels: Path | None = None
    """A file of labels. Its rows come first, then the files without a row."""
    label_from_folder: bool = False
    skipped: Collection[Path] = ()
    """Files and folders that are not part of the folder, such as the output."""

    @property
    def emptiness(self) -> str:
        """The error if there is no mesh."""
        if self.labels:
            return f"{self.labels}: no row names a file"
        return f"{self.path}: there is no file that ends in {', '.join(FORMATS)}"

    def __iter__(self) -> Iterator[LabelledFile | LeftOut]:
        skipped = {_place(path.absolute()) for path in (*self.skipped, self.labels) if path}
        found = _walk(self.path, skipped)
        return self._labelled(found, self.labels) if self.labels else map(self._unlabelled, found)

    def _unlabelled(self, found: Path | LeftOut) -> LabelledFile | LeftOut:
        if isinstance(found, LeftOut) or found.suffix.lower() in _EXTENSIONS:
            return found if isinstance(found, LeftOut) else self._file(found)
        return LeftOut(found, NO_MESH)

    def _file(self, path: Path) -> LabelledFile:
        return LabelledFile(path, folder_name(path) if self.label_from_folder else None)

    def _labelled(self, found: Iterable[Path | LeftOut], labels: Path) -> Iterator[LabelledFile | LeftOut]:
        with FirstPaths() as listed:
            for row in read_rows(labels, self.path):
                listed.put(_place(row.path), row.path)
                yield row
            for item in map(self._unlabelled, found):
                if isinstance(item, LeftOut):
                    yield item
                elif listed.find(_place(item.path)) is None:
                    yield LeftOut(item.path, NO_ROW)


@dataclass(frozen=True)
class MeshPaths:
    """Mesh files, and the files below folders, as a `MeshFolder` has them."""

    paths: Sequence[Path]
    skipped: Collection[Path] = ()

    @property
    def root(self) -> Path:
        """The deepest folder that has all of the files."""
        return Path(os.path.commonpath([(path if path.is_dir() else path.parent).absolute() for path in self.paths]))

    @property
    def emptiness(self) -> str:
        """The error if there is no mesh."""
        return f"{', '.join(map(str, self.paths))}: there is no file that ends in {', '.join(FORMATS)}"

    def __iter__(self) -> Iterator[LabelledFile | LeftOut]:
        for path in self.paths:
            if path.is_dir():
                yield from MeshFolder(path, skipped=self.skipped)
            else:
                yield LabelledFile(path, None)


def read_labels(csv_path: Path, folder: Path) -> list[LabelledFile]:
    """Return the files of a labels.csv as `read_rows` does; ParameterError if a row names a missing file."""
    files = []
    for row in read_rows(csv_path, folder):
        if isinstance(row, LeftOut):
            raise ParameterError(row.fault)
        files.append(row)
    return files


def read_rows(
    csv_path: Path, folder: Path, exists: Callable[[Path], bool] = Path.is_file
) -> Iterator[LabelledFile | LeftOut]:
    """Yield the files of a labels.csv, whose paths are relative to `folder`. `exists` tells whether there is a file.

    A file without a class has no label.

    Of the other columns that `unbend export` writes, name, metadata, parameters and policy are read if they exist.

    Paths, like file names, may contain any bytes. Bytes that are not UTF-8 become surrogates.

    Raises
    ------
    ParameterError
        If the table is not CSV, has no rows, or has no column `path` or `class`; if a row has no path, or has a class
        or name that is not UTF-8; or if metadata, parameters or policy are not a JSON object.
    """
    row = None
    try:
        with csv_path.open(newline="", encoding="utf-8-sig", errors="surrogateescape") as file:
            rows = csv.DictReader(file)
            missing = {"path", "class"} - set(rows.fieldnames or ())
            if missing:
                raise ParameterError(
                    f"{csv_path}: the header has no column {min(missing)!r}; the file must be CSV in UTF-8"
                )
            for row in rows:
                yield _labelled(row, f"{csv_path}, line {rows.line_num}", folder, exists)
    except csv.Error as error:
        raise ParameterError(f"{csv_path} is not a CSV file in UTF-8: {error}") from None
    if row is None:
        raise ParameterError(f"{csv_path}: there are no rows")


def relative_name(path: Path, folder: Path) -> str:
    """Return the path of a file as a labels.csv of `folder` has it."""
    path, folder = path.absolute(), folder.absolute()
    return printable(str(path.relative_to(folder) if path.is_relative_to(folder) else path))


def _walk(folder: Path, skipped: Collection[bytes]) -> Iterator[Path | LeftOut]:
    """Yield the files below a folder in the order of their paths, without following links to folders."""
    try:
        names = sorted(path.name for path in folder.iterdir())
    except OSError as error:
        yield _unreadable(folder, error)
        return
    for name in names:
        path = folder / name
        if skipped and _place(path.absolute()) in skipped:
            continue
        try:
            mode = path.stat().st_mode
        except PermissionError as error:  # its folder may be listed, but not entered
            yield _unreadable(path, error)
            continue
        except OSError:
            mode = 0  # a link to nowhere
        if stat.S_ISDIR(mode) and not path.is_symlink():
            yield from _walk(path, skipped)
        else:
            yield path if stat.S_ISREG(mode) else LeftOut(path, NOT_REGULAR)


def _unreadable(path: Path, error: OSError) -> LeftOut:
    return LeftOut(path, UNREADABLE, f"{path} cannot be read: {error.strerror}")


def _place(path: Path) -> bytes:
    return os.fsencode(os.path.normpath(path))


def folder_name(path: Path) -> str | None:
    """Return the class that a file has by the name of its folder; None if the folder has no name."""
    return printable(path.parent.absolute().name)[:MAX_TEXT] or None


def _labelled(
    row: dict[str, str | None], place: str, folder: Path, exists: Callable[[Path], bool]
) -> LabelledFile | LeftOut:
    path, label = row.get("path"), row.get("class")
    if not path:
        raise ParameterError(f"{place}: the path is empty")
    for column in ("class", "name"):
        text = row.get(column) or ""
        if text != printable(text):
            raise ParameterError(f"{place}: the {column} {printable(text)} is not UTF-8")
    objects = {name: _parse_object(row.get(name), f"{place}: {name}") for name in _OBJECTS}
    if not exists(folder / path):
        return LeftOut(folder / path, NO_FILE, f"{place}: there is no file {folder / path}")
    return LabelledFile(
        folder / path, label or None, row.get("name") or None, objects["metadata"], objects["parameters"] or {},
        objects["policy"] or {}, is_row=True,
    )  # fmt: skip


def _parse_object(text: str | None, what: str) -> dict[str, Any] | None:
    if not text:
        return None
    value = parse_json(text, what)
    if not isinstance(value, dict):
        raise ParameterError(f"{what} must be a JSON object")
    return value
