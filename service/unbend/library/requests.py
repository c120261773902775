"""Requests of jobs as immutable values, and their encoding in the database."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, BinaryIO, Final, Literal, Self, get_args

from unbend.errors import ParameterError, check_choice
from unbend.library.metadata import Scalar, as_stored, check_changes, check_filter
from unbend.matching.classification import DEFAULT_CLASSIFIER, get_classifier
from unbend.matching.measures import (
    DEFAULT_MEASURE,
    MEASURES,
    Measure,
    PairMeasure,
    VectorMeasure,
    get_measure,
    get_vector_measure,
)
from unbend.matching.partial import PART_MEASURES, PartMeasure
from unbend.mesh.policy import MeshPolicy
from unbend.results.jobs import JobKind
from unbend.results.rankings import DEFAULT_K
from unbend.results.shapes import IfKnown
from unbend.signature.parameters import Parameters
from unbend.signature.signature import ALGORITHM_VERSION

RANKING_MEASURES: Final = (*MEASURES, *PART_MEASURES)
"""The measures by which queries rank shapes."""

MAX_PAIRS: Final = 100
"""Largest number of shapes in a ranking by a measure of whole shapes: each comparison takes milliseconds."""

_PIECE: Final = 2**20

FileCall = Literal["mesh", "signature", "flattening", "geodesics", "match"]
"""The kind of file that a job makes of a stored shape."""


@dataclass(frozen=True)
class UploadKey:
    """The identity of an upload. Uploads with equal keys are computed and stored once."""

    sha256: str
    parameters: str
    policy: str
    version: str = ALGORITHM_VERSION

    @classmethod
    def of(cls, sha256: str, parameters: Parameters, policy: MeshPolicy) -> Self:
        """Return the key of a file for this version of the algorithm."""
        return cls(sha256, parameters.to_json(), policy.to_json())


@dataclass(frozen=True)
class UploadedFile:
    """The file of an upload on disk, with its hash, so that it need not be in memory."""

    file: BinaryIO
    sha256: str
    size: int

    @classmethod
    def of(cls, file: BinaryIO) -> Self:
        """Return a file with its hash; it is read once."""
        file.seek(0)
        found, size = hashlib.sha256(), 0
        while piece := file.read(_PIECE):
            found.update(piece)
            size += len(piece)
        return cls(file, found.hexdigest(), size)

    def read(self) -> bytes:
        """Return the bytes of the file."""
        self.file.seek(0)
        return self.file.read()


@dataclass(frozen=True)
class Upload:
    """A mesh file to compute."""

    data: bytes | UploadedFile
    file_type: str
    """The extension of the file's name, used if the content does not identify the format."""
    parameters: Parameters = field(default_factory=Parameters)
    policy: MeshPolicy = field(default_factory=MeshPolicy)

    @cached_property
    def key(self) -> UploadKey:
        """The identity of this upload."""
        data = self.data
        sha256 = hashlib.sha256(data).hexdigest() if isinstance(data, bytes) else data.sha256
        return UploadKey.of(sha256, self.parameters, self.policy)

    @property
    def size(self) -> int:
        """The number of bytes of the file."""
        return len(self.data) if isinstance(self.data, bytes) else self.data.size

    def open(self) -> bytes | BinaryIO:
        """Return the bytes of the file, or the file."""
        return self.data if isinstance(self.data, bytes) else self.data.file

    def read(self) -> bytes:
        """Return the bytes of the file."""
        return self.data if isinstance(self.data, bytes) else self.data.read()


@dataclass(frozen=True)
class ShapeRequest:
    """The description of an uploaded shape."""

    name: str
    label: str | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    sent: Sequence[str] = ()
    """The fields of "name", "label" and "metadata" that the caller gave."""
    if_known: IfKnown = "keep"

    @classmethod
    def of(cls, default_name: str, given: Mapping[str, Any], if_known: IfKnown = "keep") -> Self:
        """Return a request from the name, label and metadata that a caller gave; None means not given.

        Raises
        ------
        ParameterError
            If one of them cannot be stored, or there is no such `if_known`.
        """
        check_choice("if_known", if_known, get_args(IfKnown))
        sent = {name: value for name, value in given.items() if value is not None}
        described: dict[str, Any] = {"name": default_name} | sent
        check_changes(described)
        if "metadata" in sent:  # so that it equals the metadata of a shape that took it before
            described["metadata"] = as_stored(sent["metadata"])
        return cls(**described, sent=tuple(sent), if_known=if_known)

    @property
    def changes(self) -> dict[str, Any]:
        """The fields that the caller gave, with their values."""
        return {name: getattr(self, name) for name in self.sent}

    def as_dict(self) -> dict[str, Any]:
        """Return the request as JSON values."""
        return {**vars(self), "metadata": dict(self.metadata), "sent": list(self.sent)}


@dataclass(frozen=True)
class QueryRequest:
    """A validated query: measure, classifier, and number of shapes.

    Raises
    ------
    ParameterError
        If there is no such measure or classifier, `k` is below 1, or above `MAX_PAIRS` for a measure of whole shapes,
        a measure of parts has another classifier than the default, or a value of `metadata` is an array or an object.
        `field` names the argument.
    """

    measure: str = DEFAULT_MEASURE
    classifier: str = DEFAULT_CLASSIFIER
    k: int = DEFAULT_K
    exact: bool = False
    """Whether every shape is compared, even if the database has an approximate index."""
    label: str | None = None
    """Only shapes of this class, if given."""
    metadata: Mapping[str, Scalar] = field(default_factory=dict)
    """Only shapes whose metadata have these members, with these values."""

    def __post_init__(self) -> None:
        check_filter(self.metadata)
        _check("measure", _check_ranking_measure, self.measure)
        _check("classifier", get_classifier, self.classifier)
        if self.part_measure and self.classifier != DEFAULT_CLASSIFIER:
            raise ParameterError(
                f"{self.measure} has no classifier but {DEFAULT_CLASSIFIER}, not {self.classifier}", field="classifier"
            )
        if self.k < 1:
            raise ParameterError(f"k must be at least 1, not {self.k}", field="k")
        if self.pair_measure and self.k > MAX_PAIRS:
            raise ParameterError(
                f"k must be at most {MAX_PAIRS} with {self.measure}, which compares whole shapes, not {self.k}",
                field="k",
            )

    @property
    def vector_measure(self) -> VectorMeasure:
        """The measure of the search: the default one if `measure` compares whole shapes."""
        return get_vector_measure(DEFAULT_MEASURE if self.pair_measure else self.measure)

    @property
    def part_measure(self) -> PartMeasure | None:
        """The measure of parts, if `measure` is one."""
        return PART_MEASURES.get(self.measure)

    @property
    def pair_measure(self) -> PairMeasure | None:
        """The measure that orders the nearest shapes, if `measure` compares whole shapes."""
        if self.part_measure:
            return None
        measure: Measure = get_measure(self.measure)
        return measure if isinstance(measure, PairMeasure) else None

    def as_dict(self) -> dict[str, Any]:
        """Return the request as JSON values."""
        return {**vars(self), "metadata": dict(self.metadata)}


@dataclass(frozen=True)
class FileRequest:
    """A file to make of a stored shape."""

    call: FileCall
    arguments: Mapping[str, Any]
    file_type: str
    name: str

    def as_dict(self) -> dict[str, Any]:
        """Return the request as JSON values."""
        return {**vars(self), "arguments": dict(self.arguments)}


JobRequest = ShapeRequest | QueryRequest | FileRequest

_TYPES: Final[Mapping[JobKind, type[JobRequest]]] = {
    "shape": ShapeRequest,
    "query": QueryRequest,
    "file": FileRequest,
}


def kind_of(request: JobRequest) -> JobKind:
    """Return the kind of the job of a request."""
    return next(kind for kind, type_ in _TYPES.items() if isinstance(request, type_))


def decode_request(kind: JobKind, stored: Mapping[str, Any]) -> JobRequest | None:
    """Return a request from its column in the database; None for a job that has ended."""
    return _TYPES[kind](**stored) if stored else None


@lru_cache(maxsize=256)
def decode_parameters(stored: str) -> Parameters:
    """Return parameters from their column in the database."""
    return Parameters.from_json(stored)


@lru_cache(maxsize=256)
def decode_policy(stored: str) -> MeshPolicy:
    """Return a reading policy from its column in the database."""
    return MeshPolicy.from_json(stored)


def _check_ranking_measure(name: str) -> None:
    check_choice("measure", name, RANKING_MEASURES)


def _check(name: str, get: Any, value: str) -> None:
    try:
        get(value)
    except ParameterError as error:
        error.field = name
        raise
