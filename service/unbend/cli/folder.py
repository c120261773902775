"""Folders of meshes and their labels."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from unbend.errors import ParameterError
from unbend.mesh.formats import FORMATS
from unbend.names import MAX_TEXT, printable


@dataclass(frozen=True)
class LabelledFile:
    """A mesh file and the class it belongs to."""

    path: Path
    label: str | None


def read_labels(csv_path: Path, folder: Path) -> list[LabelledFile]:
    """Return the files of a labels.csv, whose paths are relative to `folder`. One without a class has no label.

    A path may hold any bytes, because the names of files may: bytes that are not UTF-8 become surrogates.

    Raises
    ------
    ParameterError
        If the header lacks `path` or `class`, a row lacks a path, a class is not UTF-8, or a file is not there.
    """
    try:
        with csv_path.open(newline="", encoding="utf-8-sig", errors="surrogateescape") as file:
            rows = csv.DictReader(file)
            missing = {"path", "class"} - set(rows.fieldnames or ())
            if missing:
                raise ParameterError(f"{csv_path}: the header has no column {min(missing)!r}; it must be CSV in UTF-8")
            files = [_labelled(row, csv_path, rows.line_num, folder) for row in rows]
    except csv.Error as error:
        raise ParameterError(f"{csv_path} is not a CSV file in UTF-8: {error}") from None
    if not files:
        raise ParameterError(f"{csv_path}: there are no rows")
    return files


def find_meshes(folder: Path, *, label_from_folder: bool = False) -> list[LabelledFile]:
    """Return the mesh files below `folder` in the order of their names."""
    endings = {f".{name}" for name in FORMATS}
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in endings and path.is_file())
    if not paths:
        raise ParameterError(f"{folder}: there is no file that ends in {', '.join(FORMATS)}")
    return [LabelledFile(path, _folder_name(path) if label_from_folder else None) for path in paths]


def _folder_name(path: Path) -> str | None:
    return printable(path.parent.absolute().name)[:MAX_TEXT] or None


def _labelled(row: dict[str, str | None], csv_path: Path, line: int, folder: Path) -> LabelledFile:
    path, label = row.get("path"), row.get("class")
    if not path:
        raise ParameterError(f"{csv_path}, line {line}: the path is empty")
    if not (folder / path).is_file():
        raise ParameterError(f"{csv_path}, line {line}: there is no file {folder / path}")
    if label and label != printable(label):
        raise ParameterError(f"{csv_path}, line {line}: the class {printable(label)} is not UTF-8")
    return LabelledFile(folder / path, label or None)
