"""The entries of a shard: results of the content of a file, and descriptions of files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Self, cast

from unbend.errors import ResultsError
from unbend.library.computed import check_computed, check_key
from unbend.library.packing import PackedSignature
from unbend.library.requests import UploadKey
from unbend.library.shape_rows import ComputedShape
from unbend.library.shards.entries import Entry, encode, read_part
from unbend.local.signatures import LOCAL_VERSION

SHAPE: Final = "shape"
FILE: Final = "file"

_KEY: Final = ("sha256", "parameters", "policy", "version")
_VECTOR: Final = "descriptor."
_LONGEST_PATH: Final = 4096
_MOST_BYTES: Final = 2**24
"""Most bytes of a part other than the mesh. The largest signature has 5000 samples, and is far smaller."""


def encode_shape(computed: ComputedShape, mesh: bytes) -> list[bytes]:
    """Return the entry of results and of the file that they belong to."""
    packed = computed.signature
    content = vars(computed.key) | {
        "area": computed.area, "report": computed.report, "stress": packed.stress, "dimension": packed.dimension,
        "boundary": packed.boundary, "warnings": packed.warnings, "local_version": LOCAL_VERSION,
    }  # fmt: skip
    parts = {"mesh": mesh, "signature": packed.payload}
    parts |= {f"{_VECTOR}{name}": vector for name, vector in packed.vectors.items()}
    return encode(SHAPE, content, parts | ({"local": packed.local} if packed.local else {}))


def key_of(entry: Entry) -> UploadKey:
    """Return the key of an entry; ResultsError if it is malformed."""
    values = [entry.content.get(name) for name in _KEY]
    if not all(isinstance(value, str) for value in values):
        raise entry.error("the entry is malformed")
    return UploadKey(*map(str, values))


def read_shape(entry: Entry) -> ComputedShape:
    """Return the results of an entry, without the mesh, which `read_mesh_of` checks.

    Raises
    ------
    ResultsError
        If anything of the entry is damaged or invalid, or is of another version of the algorithm.
    """
    key = key_of(entry)
    _check(entry, partial(check_key, key))
    if not {"mesh", "signature"} <= entry.parts.keys() or entry.parts["mesh"].sha256 != key.sha256:
        raise entry.error("the entry is malformed")
    if any(part.size > _MOST_BYTES for name, part in entry.parts.items() if name != "mesh"):
        raise entry.error("a part is too large")
    computed = _computed(entry, key, {name: read_part(entry, name) for name in entry.parts if name != "mesh"})
    _check(entry, partial(check_computed, computed))
    return computed


def _computed(entry: Entry, key: UploadKey, parts: Mapping[str, bytes]) -> ComputedShape:
    """Return the values of an entry, which may be of any type."""
    content: Mapping[str, Any] = entry.content
    warnings: Any = content.get("warnings")
    warnings = tuple(warnings) if isinstance(warnings, list) else warnings
    is_local = content.get("local_version") == LOCAL_VERSION  # `unbend complete` computes those of another version
    packed = PackedSignature(
        key.parameters, key.version, cast("float", content.get("stress")), parts["signature"],
        {name.removeprefix(_VECTOR): data for name, data in parts.items() if name.startswith(_VECTOR)},
        warnings, content.get("dimension"), content.get("boundary"),
        parts.get("local") if is_local else None,
    )  # fmt: skip
    return ComputedShape(key, packed, cast("float", content.get("area")), content.get("report") or {})


def read_mesh_of(entry: Entry) -> bytes:
    """Return the mesh of an entry that `read_shape` has accepted; ResultsError if it is damaged."""
    return read_part(entry, "mesh")


@dataclass(frozen=True)
class FileRecord:
    """A file of a folder: its path, its description, and the key of its results."""

    path: str
    """The path relative to the folder, with "/" between folders."""
    key: UploadKey
    folder: str | None
    """Name of the folder that contains the file, for `--label-from folder`."""
    label: str | None = None
    name: str | None = None
    metadata: dict[str, Any] | None = None
    is_row: bool = False
    """Whether the description is a row of a file of labels."""
    written: float = 0.0
    """Time of writing, in seconds since 1970. Of several records of a path, the last is valid."""

    @property
    def description(self) -> Mapping[str, Any]:
        """Everything but the time and the key."""
        return {name: value for name, value in vars(self).items() if name not in {"written", "key"}}

    def encode(self) -> list[bytes]:
        """Return the entry of this record."""
        return encode(FILE, self.as_dict(), {})

    def as_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        return {**self.description, **vars(self.key), "written": self.written}

    @classmethod
    def of(cls, entry: Entry) -> Self:
        """Return the record of an entry; ResultsError if it is malformed.

        Name, class and metadata are checked when they are stored.
        """
        values: dict[str, Any] = {name: entry.content.get(name) for name in _KINDS}
        if not all(isinstance(values[name], kinds) for name, kinds in _KINDS.items()):
            raise entry.error("the entry is malformed")
        if not 0 < len(values["path"]) <= _LONGEST_PATH or not math.isfinite(values["written"]):
            raise entry.error("the entry is malformed")
        return cls(**values, key=key_of(entry))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the record of the values that `as_dict` returned."""
        own = {name: value for name, value in values.items() if name not in _KEY}
        return cls(**own, key=UploadKey(*(values[name] for name in _KEY)))


_OPTIONAL: Final = (str, type(None))
_KINDS: Final[Mapping[str, Any]] = {
    "path": str, "folder": _OPTIONAL, "label": _OPTIONAL, "name": _OPTIONAL, "metadata": (dict, type(None)),
    "is_row": bool, "written": float,
}  # fmt: skip


def _check(entry: Entry, check: Callable[[], None]) -> None:
    """Run a check, and name the place of the entry in its error."""
    try:
        check()
    except ResultsError as error:
        raise entry.error(str(error)).with_advice(error.advice) from error
