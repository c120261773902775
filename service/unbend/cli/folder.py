"""Folders of meshes and their labels."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from unbend.errors import ParameterError
from unbend.jsons import parse_json
from unbend.mesh.formats import FORMATS
from unbend.names import MAX_TEXT, printable


@dataclass(frozen=True)
class LabelledFile:
    """A mesh file, its class, and the other data that `unbend export` wrote."""

    path: Path
    label: str | None
    name: str | None = None
    metadata: dict[str, Any] | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    policy: dict[str, Any] = field(default_factory=dict)


def read_labels(csv_path: Path, folder: Path) -> list[LabelledFile]:
    """Return the files of a labels.csv, whose paths are relative to `folder`.

    A file without a class has no label.

    Of the other columns that `unbend export` writes, name, metadata, parameters and policy are read if they exist.

    Paths, like file names, may contain any bytes. Bytes that are not UTF-8 become surrogates.

    Raises
    ------
    ParameterError
        If the table is not CSV, has no rows, or has no column `path` or `class`; if a row has no path, names a missing
        file, or has a class or name that is not UTF-8; or if metadata, parameters or policy are not a JSON object.
    """
    try:
        with csv_path.open(newline="", encoding="utf-8-sig", errors="surrogateescape") as file:
            rows = csv.DictReader(file)
            missing = {"path", "class"} - set(rows.fieldnames or ())
            if missing:
                raise ParameterError(
                    f"{csv_path}: the header has no column {min(missing)!r}; the file must be CSV in UTF-8"
                )
            files = [_labelled(row, csv_path, rows.line_num, folder) for row in rows]
    except csv.Error as error:
        raise ParameterError(f"{csv_path} is not a CSV file in UTF-8: {error}") from None
    if not files:
        raise ParameterError(f"{csv_path}: there are no rows")
    return files


_OBJECTS: Final = ("metadata", "parameters", "policy")


def find_meshes(folder: Path, *, label_from_folder: bool = False) -> list[LabelledFile]:
    """Return the mesh files below `folder` in the order of their paths."""
    extensions = {f".{name}" for name in FORMATS}
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in extensions and path.is_file())
    if not paths:
        raise ParameterError(f"{folder}: there is no file that ends in {', '.join(FORMATS)}")
    return [LabelledFile(path, _folder_name(path) if label_from_folder else None) for path in paths]


def ignored_files(folder: Path) -> list[Path]:
    """Return the files below `folder` that `find_meshes` ignores, except hidden ones."""
    extensions = {f".{name}" for name in FORMATS}
    files = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    return sorted(path for path in files if path.suffix.lower() not in extensions)


def _folder_name(path: Path) -> str | None:
    return printable(path.parent.absolute().name)[:MAX_TEXT] or None


def _labelled(row: dict[str, str | None], csv_path: Path, line: int, folder: Path) -> LabelledFile:
    path, label = row.get("path"), row.get("class")
    if not path:
        raise ParameterError(f"{csv_path}, line {line}: the path is empty")
    if not (folder / path).is_file():
        raise ParameterError(f"{csv_path}, line {line}: there is no file {folder / path}")
    for column in ("class", "name"):
        text = row.get(column) or ""
        if text != printable(text):
            raise ParameterError(f"{csv_path}, line {line}: the {column} {printable(text)} is not UTF-8")
    objects = {name: _parse_object(row.get(name), f"{csv_path}, line {line}: {name}") for name in _OBJECTS}
    return LabelledFile(
        folder / path, label or None, row.get("name") or None, objects["metadata"], objects["parameters"] or {},
        objects["policy"] or {},
    )  # fmt: skip


def _parse_object(text: str | None, what: str) -> dict[str, Any] | None:
    if not text:
        return None
    value = parse_json(text, what)
    if not isinstance(value, dict):
        raise ParameterError(f"{what} must be a JSON object")
    return value
