"""Models of requests and responses, with their documentation in OpenAPI."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

from unbend.api.schema.fields import (
    EXACT,
    METADATA_FILTER,
    QUERY_CONDITIONS,
    ClassifierName,
    Id,
    MeasureName,
    MetadataScalar,
    Whole,
)
from unbend.correspondence.match import Turn
from unbend.correspondence.pieces import Part as PieceOf
from unbend.library.records import JobRecord
from unbend.matching.classification import DEFAULT_CLASSIFIER
from unbend.matching.measures import DEFAULT_MEASURE
from unbend.mesh.formats import WrittenFormat
from unbend.names import MAX_TEXT
from unbend.results.jobs import JobKind
from unbend.results.shapes import AddedShape, ShapeRecord

_WARNINGS: Final = "Reasons why the result may be wrong, and what to do; usually empty."
_IGNORED: Final = (
    "Fields of `name`, `label` and `metadata` that differ from the stored shape, which did not take them. To set them, "
    "send the file with `if_known=update`, or PATCH the shape."
)
_WARNING: Final = (
    "only 50.0% of the area was kept, the largest of 2 components, so results may describe only a part of the shape: "
    'the policy components="bridge" connects all of them'
)


class Shape(BaseModel):
    """A shape of the library."""

    id: Id
    name: str = Field(examples=["cat-03"])
    label: str | None = Field(description="The known class of the shape.", examples=["cat"])
    metadata: dict[str, Any] = Field(examples=[{"scanner": "A", "year": 2026}])
    sha256: str = Field(description="Hash of the uploaded file.")
    size: int = Field(description="Size of the uploaded file in bytes.", examples=[20480])
    parameters: dict[str, Any] = Field(description="Parameters of the signature.")
    policy: dict[str, Any] = Field(
        description="How the file was read.",
        examples=[{"components": "largest", "max_vertices": None, "smooth": 0, "seams": "stitch"}],
    )
    version: str = Field(description="Version of the algorithm; signatures of different versions are not compared.")
    area: float = Field(description="Area of the surface, in squared units of the file.")
    stress: float = Field(
        description="Eq. 2 of the paper: 0 if the distances of the signature equal the geodesic distances."
    )
    dimension: int | None = Field(
        description="Effective dimension, itself a bending invariant; null for signatures of version 4 or earlier."
    )
    report: dict[str, Any] = Field(description="Findings and repairs while the mesh was read; `notes` are sentences.")
    warnings: list[str] = Field(description=_WARNINGS, examples=[[_WARNING]])
    created_at: datetime
    updated_at: datetime = Field(description="Time of the last change of name, label or metadata.")
    revision: int = Field(description="Revision of the library that last changed the shape; 0 if none did.")
    seq: int = Field(description="Place of the shape in the order of adding.")

    @classmethod
    def of(cls, record: ShapeRecord) -> Self:
        """Make the response for a stored shape."""
        values = {**vars(record), "parameters": record.parameters.as_dict(), "policy": record.policy.as_dict()}
        return cls.model_validate(values)


class KnownShape(Shape):
    """A stored shape whose file was sent again."""

    ignored: list[str] = Field(description=_IGNORED, examples=[["label"]])
    updated: list[str] = Field(
        description="Fields that differed from the stored shape, which took them.", examples=[[]]
    )

    @classmethod
    def of_known(cls, known: AddedShape) -> Self:
        """Make the response for a shape that was stored already."""
        return cls.model_validate(
            Shape.of(known).model_dump() | {"ignored": list(known.ignored), "updated": list(known.updated)}
        )


class ShapePage(BaseModel):
    """A page of shapes in the order of adding."""

    items: list[Shape]
    next_cursor: str | None = Field(description="The `cursor` of the next page; null on the last.")


class ShapeChanges(BaseModel):
    """Changes of a shape; missing fields do not change."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"label": "cat"}]})

    # Factories, because a missing field has no value, and OpenAPI must not show a default.
    name: str = Field(default_factory=str, min_length=1, max_length=MAX_TEXT)
    label: str | None = Field(default_factory=lambda: None, min_length=1, max_length=MAX_TEXT, examples=["cat"])
    metadata: dict[str, Any] = Field(default_factory=dict)


class JobError(BaseModel):
    """The error of a failed job."""

    code: str = Field(description="A stable name for programs.", examples=["mesh_read"])
    message: str = Field(examples=["line 17: three coordinates expected, found '0.1 0.2'"])
    advice: str = ""


class ClassMatch(BaseModel):
    """A class and its distance from the query."""

    label: str = Field(examples=["cat"])
    distance: float = Field(
        description="Distance by the classifier; by default, the distance of the nearest member.", examples=[0.041]
    )
    confidence: float = Field(
        description="Probability of this class, if the query belongs to any of them.", examples=[0.97]
    )


class Part(BaseModel):
    """The relation of a query to a shape, under a measure of parts."""

    relation: Literal["part", "contains", "whole"] = Field(
        description="The query is a part of the shape, contains it, or is a whole like it."
    )
    covered: float = Field(description="Area of the smaller surface over that of the larger one.", examples=[0.3])
    matched: float = Field(
        description="Share of the compared circles that are where the others say they must be.", examples=[0.95]
    )
    residual: float = Field(
        description="Root mean square error of distances between matched circles, in units of the query.",
        examples=[1.7],
    )
    scale: float = Field(description="Length in units of the shape of a length 1 in units of the query.", examples=[1])
    centre: tuple[float, float, float] = Field(
        description="A point of the query, as far as possible from the boundary of the smaller surface.",
        examples=[[0.1, 0.4, 1.2]],
    )
    place: tuple[float, float, float] = Field(
        description="The same place on the shape, in the coordinates of the file of the shape.",
        examples=[[0.3, 0.2, 1.1]],
    )


class ShapeMatch(BaseModel):
    """A stored shape and its distance from the query."""

    id: Id
    name: str = Field(examples=["cat-03"])
    label: str | None = Field(examples=["cat"])
    distance: float = Field(examples=[0.041])
    part: Part | None = Field(None, description="Only under measures of parts, for the nearest shapes.")


class Ranking(BaseModel):
    """The classes and shapes nearest to a query, best first."""

    measure: str = Field(examples=[DEFAULT_MEASURE])
    classes: list[ClassMatch]
    shapes: list[ShapeMatch]
    known: bool | None = Field(
        description="Whether the query is about as near to its nearest member of the best class as members are to "
        "their own nearest neighbours in it. If not, it may belong to no class of the library. Null if the class has a "
        "single member."
    )
    warnings: list[str] = Field(
        default_factory=list,  # rankings of earlier versions have none
        description=f"Warnings about the query. {_WARNINGS}",
    )
    exact: bool = Field(
        True, description="Whether every shape was compared. If not, an approximate index may have missed a near shape."
    )


class JobSummary(BaseModel):
    """A job: queued, running, and finally succeeded, failed or cancelled."""

    id: Id
    kind: JobKind
    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    stage: str = Field(examples=["geodesics"])
    progress: float = Field(ge=0, le=1, examples=[0.42])
    detail: dict[str, float] = Field(
        description="Details of the running stage: `sample` of `samples`, `row` of `rows`, or `iteration` and "
        "`stress`. `seconds` since the worker began are updated every second. Empty until a worker begins.",
        examples=[{"row": 120, "rows": 300, "seconds": 4.2}],
    )
    position: int | None = Field(description="Number of jobs before this one in the queue; null once it runs.")
    attempts: int = Field(description="Number of attempts. A job whose process died is attempted again.")
    error: JobError | None
    shape_id: Id | None = Field(
        description="The shape of a succeeded upload, or the shape of which the job makes a file."
    )
    warnings: list[str] = Field(description=f"Warnings about a succeeded job. {_WARNINGS}")
    ignored: list[str] = Field(description=f"If the shape of an upload was stored meanwhile: {_IGNORED}")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None

    @classmethod
    def of(cls, record: JobRecord, position: int | None = None) -> Self:
        """Make the response for a stored job."""
        values = {name: getattr(record, name) for name in cls.model_fields if name != "position"}
        return cls.model_validate(values | {"position": position})


class Job(JobSummary):
    """A job with its result."""

    result: Ranking | None = Field(
        description="The ranking of a succeeded query, with the present names and labels of its shapes."
    )


class JobList(BaseModel):
    """A page of jobs without results, the newest first."""

    items: list[JobSummary]
    next_cursor: str | None = Field(description="The `cursor` of the next page; null on the last.")


class Forgotten(BaseModel):
    """The response to a deletion of jobs."""

    forgotten: int = Field(description="Number of deleted jobs.", examples=[1200])


class ShapeQuery(BaseModel):
    """A query by a stored shape."""

    model_config = ConfigDict(extra="forbid", strict=True, json_schema_extra=QUERY_CONDITIONS)

    shape_id: Annotated[Id, Field(min_length=1, max_length=64)]
    measure: MeasureName = DEFAULT_MEASURE
    classifier: ClassifierName = DEFAULT_CLASSIFIER
    k: Whole = Field(10, ge=1, le=1000)
    exact: bool = Field(False, description=EXACT)
    label: str | None = Field(None, min_length=1, max_length=MAX_TEXT, description="Only shapes of this class.")
    metadata: dict[str, MetadataScalar] = Field(default_factory=dict, description=METADATA_FILTER)


class Match(BaseModel):
    """A match of two stored shapes."""

    model_config = ConfigDict(extra="forbid", strict=True)

    a: Annotated[Id, Field(min_length=1, max_length=64, description="The shape whose vertices are matched.")]
    b: Annotated[Id, Field(min_length=1, max_length=64, description="The shape whose points they are.")]
    orientation: Turn = Field(
        "keep", description="Whether the match keeps the orientation of the triangles, reverses it, or either."
    )
    part: PieceOf = Field(
        "auto",
        description="Whether `a` is a piece of `b`: `a`, `no`, or `auto`, which takes it for one if it is open and "
        "smaller, and `b` is closed.",
    )
    samples: Whole = Field(300, ge=20, le=2000, description="Farthest point samples of each shape.")
    format: Literal["json", WrittenFormat, "npz"] = Field(
        "json", description="`json` or `npz`: the points. Others: `a` in the colours of `b`."
    )


class ClassCount(BaseModel):
    """A class and its size."""

    label: str = Field(examples=["cat"])
    count: int = Field(examples=[6])


class ClassList(BaseModel):
    """The classes of the library."""

    items: list[ClassCount]
    shapes: int = Field(description="Number of all shapes, also of those without a class.")


class MapItem(BaseModel):
    """A shape and its points on the map."""

    id: Id
    name: str = Field(examples=["cat-03"])
    label: str | None = Field(examples=["cat"])
    point: list[float] = Field(description="Point by the signature.", examples=[[0.4, -0.1]])
    original: list[float] = Field(description="Point by the surface in space, for comparison.", examples=[[0.2, 0.3]])


class ShapeMap(BaseModel):
    """Shapes as points whose distances approximate those of their descriptors (the paper's D_M and Fig. 8)."""

    measure: str = Field(examples=[DEFAULT_MEASURE])
    stress: float = Field(description="Eq. 2 of the points: 0 if their distances equal those of the descriptors.")
    original_stress: float = Field(description="Eq. 2 of the originals.")
    count: int = Field(description="Number of shapes that `items` are chosen from.")
    items: list[MapItem]
    warnings: list[str] = Field(description="Why the map is empty, although the library has shapes.")


class ClassFigures(BaseModel):
    """The metrics of one class."""

    label: str = Field(examples=["cat"])
    queries: int
    members: int = Field(description="Shapes of the class.")
    accuracy: float = Field(description="Share of queries whose nearest other shape has the same class.")
    nn: float | None
    ft: float | None
    st: float | None
    e: float | None
    dcg: float | None
    map: float | None


class Confusion(BaseModel):
    """Confusions between classes."""

    labels: list[str]
    counts: list[list[int]] = Field(
        description="Number of shapes by their class (row) and the class of the nearest other shape (column)."
    )


class PrecisionRecall(BaseModel):
    """Mean precision at levels of recall."""

    recall: list[float]
    precision: list[float]


class EvaluationResult(BaseModel):
    """Retrieval metrics of the Princeton Shape Benchmark, for the stored shapes."""

    measure: str = Field(examples=[DEFAULT_MEASURE])
    nn: float | None = Field(description="Nearest neighbour.")
    ft: float | None = Field(description="First tier.")
    st: float | None = Field(description="Second tier.")
    e: float | None = Field(description="E-measure of the first 32 results.")
    dcg: float | None = Field(description="Discounted cumulative gain.")
    map: float | None = Field(description="Mean average precision.")
    accuracy: float = Field(
        description="Nearest neighbour over all shapes, including those that are alone in their class."
    )
    queries: int = Field(
        description="Number of queries. In a very large library, only some shapes are queries, chosen evenly."
    )
    unanswered: int
    classes: list[ClassFigures]
    confusion: Confusion | None = Field(description="Null for more than 1000 classes.")
    precision_recall: PrecisionRecall


class Descriptors(BaseModel):
    """The descriptors of a shape, by measure."""

    descriptors: dict[str, list[float]]


class Distances(BaseModel):
    """Geodesic distances from one vertex, in units of the file."""

    source: int
    distances: list[float | None] | None = Field(
        description="One for each vertex of the file; null if it is unreachable, or if simplification removed it. Null "
        "in place of all with `distances=false`."
    )
    target: int | None = None
    path: list[Annotated[list[float], Field(min_length=3, max_length=3)]] | None = Field(
        None, description="The minimal path to the target, a polyline on the surface as it was read."
    )
    length: float | None = Field(None, description="Length of the path.")


class DemoJobs(BaseModel):
    """The jobs that compute the demo shapes."""

    jobs: int = Field(description="Number of jobs sent; shapes that are stored already need none.", examples=[21])


class Capacity(BaseModel):
    """The load of the service."""

    workers: int
    running: int = Field(description="Number of claimed jobs, some of which wait for a worker.")
    queued: int
    max_queued: int
    search: Literal["memory", "database"] = Field(
        description="Who searches by the default measure: the exact index in memory, or the database."
    )
    recall: float | None = Field(
        description="Share of the ten nearest shapes that the database finds, as `unbend index` measured it last."
    )


class Health(BaseModel):
    """The response of a healthy service."""

    status: Literal["ok"] = "ok"
