"""Export of a library as files and a labels.csv, which `unbend import` and `unbend evaluate` read."""

from __future__ import annotations

import contextlib
import csv
import itertools
import json
import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from sqlalchemy import Connection

from unbend.errors import ParameterError
from unbend.library.mesh_files import MeshFiles
from unbend.library.shape_rows import MAX_PAGE, get_file, list_shapes
from unbend.library.storage.store import Store
from unbend.mesh.formats import FORMATS
from unbend.mesh.formats.detect import detect_format
from unbend.results.shapes import ShapeRecord

LABELS: Final = "labels.csv"
_COLUMNS: Final = (
    "path", "class", "id", "name", "metadata", "sha256", "size", "parameters", "policy", "version", "created_at",
)  # fmt: skip
_MAX_BYTES: Final = 150
"""Longest name of a shape in a file name: with an id and an extension, all file systems accept it."""
_UNSAFE: Final = re.compile(r'[\x00-\x1f\x7f-\x9f/\\:*?"<>|\u2028\u2029\u202a-\u202e\u2066-\u2069\ufeff]')
_FIRST: Final = re.compile(r"^[-.~=+@\s]")
"""First characters that make a file hidden, an option of a command, or a spreadsheet formula."""
_DEVICES: Final = re.compile(r"^(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)


def export(store: Store, files: MeshFiles, folder: str | Path) -> int:
    """Write the file of every shape, byte for byte, and then labels.csv: if labels.csv exists, the export is complete.

    Files are named after the shapes, as far as file systems allow; of shapes with the same name, all but the first also
    get their ids. The export is one state of the library, even if others write to the library meanwhile.

    Parameters
    ----------
    store : Store
    files : MeshFiles
    folder : str or Path
        An empty or new folder.

    Returns
    -------
    int
        Number of shapes.

    Raises
    ------
    ParameterError
        If the folder is not empty.
    NotFoundError
        If somebody removes a shape meanwhile whose file is in an object store.
    """
    target = Path(folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise ParameterError(f"{target} exists already, and is not an empty folder")
    target.mkdir(parents=True, exist_ok=True)
    unfinished = target / f"{LABELS}.part"
    with store.read() as connection, unfinished.open("x", newline="", encoding="utf-8") as file:
        rows = csv.DictWriter(file, _COLUMNS)
        rows.writeheader()
        count = 0
        for record in _records(connection):
            data = get_file(connection, record.sha256)
            path = _write(target, record, files.fetch(record.sha256) if data is None else data)
            rows.writerow(_row(path, record))
            count += 1
    unfinished.rename(target / LABELS)
    return count


def safe_name(name: str) -> str:
    """Return a file name for a shape's name: no path, no hidden file, no device, not too long."""
    text = _UNSAFE.sub("_", unicodedata.normalize("NFC", name))
    text = text.encode(errors="replace")[:_MAX_BYTES].decode(errors="ignore").rstrip(". ")
    text = _FIRST.sub("_", text) or "_"
    return f"_{text}" if _DEVICES.match(text) else text


def _records(connection: Connection) -> Iterator[ShapeRecord]:
    cursor: str | None = None
    while True:
        page = list_shapes(connection, label=None, cursor=cursor, limit=MAX_PAGE)
        yield from page.items
        cursor = page.next_cursor
        if cursor is None:
            return


def _write(folder: Path, record: ShapeRecord, data: bytes) -> Path:
    """Write a file under its first free name. The file system decides which names are equal."""
    extension, stems = _extension(record, data), _stems(record)
    while True:
        path = folder / f"{next(stems)}.{extension}"
        with contextlib.suppress(FileExistsError), path.open("xb") as file:
            file.write(data)
            return path


def _stems(record: ShapeRecord) -> Iterator[str]:
    stem = safe_name(record.name)
    yield stem
    yield f"{stem}-{record.id}"
    for number in itertools.count(2):
        yield f"{stem}-{record.id}-{number}"


def _extension(record: ShapeRecord, data: bytes) -> str:
    known = record.report.get("file_type")
    return str(known) if known in FORMATS else detect_format(data)


def _row(path: Path, record: ShapeRecord) -> dict[str, Any]:
    own = {name: getattr(record, name) for name in _COLUMNS if hasattr(record, name)}
    objects = {
        name: json.dumps(value, ensure_ascii=False, sort_keys=True)
        for name, value in (
            ("metadata", record.metadata),
            ("parameters", record.parameters.as_dict()),
            ("policy", record.policy.as_dict()),
        )
    }
    texts = {"path": path.name, "class": record.label or "", "created_at": record.created_at.isoformat()}
    return own | objects | texts
