"""What the service takes and answers, as OpenAPI documents it."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

from unbend.api.fields import FEWER_PAIRS, ClassifierName, Id, MeasureName, Whole
from unbend.library.records import JobKind, JobRecord, ShapeRecord
from unbend.library.shapes import Known
from unbend.matching.classification import DEFAULT_CLASSIFIER
from unbend.matching.measures import DEFAULT_MEASURE
from unbend.names import MAX_TEXT

_WARNINGS: Final = "Sentences that say why the answer may be wrong, and what to do; mostly empty."
_IGNORED: Final = (
    "What was sent with the file, and the stored shape did not take: `name`, `label`, `metadata`. To change them, send "
    "it with `if_known=update`, or PATCH the shape."
)
_WARNING: Final = (
    "only 50.0% of the area was kept, the largest of 2 components, so that the answer may be that of a part: the "
    'reading policy components="bridge" links all of them'
)


class Shape(BaseModel):
    """A member of the library."""

    id: Id
    name: str = Field(examples=["cat-03"])
    label: str | None = Field(description="The class it is known to belong to.", examples=["cat"])
    metadata: dict[str, Any] = Field(examples=[{"scanner": "A", "year": 2026}])
    sha256: str = Field(description="Of the file that was uploaded.")
    size: int = Field(description="Bytes of that file.", examples=[20480])
    parameters: dict[str, Any] = Field(description="What the signature was computed with.")
    policy: dict[str, Any] = Field(
        description="How the file was read.",
        examples=[{"components": "largest", "max_vertices": None, "smooth": 0, "seams": "stitch"}],
    )
    version: str = Field(description="Of the algorithm; signatures of different versions are not compared.")
    area: float = Field(description="Of the surface, in squared units of the file.")
    stress: float = Field(description="Eq. 2 of the paper: 0 where the signature has exactly the geodesic distances.")
    dimension: int | None = Field(
        description="Effective dimension, itself a bending invariant; null for signatures of version 4 or earlier."
    )
    report: dict[str, Any] = Field(description="What reading the mesh found and repaired; `notes` in plain words.")
    warnings: list[str] = Field(description=_WARNINGS, examples=[[_WARNING]])
    created_at: datetime
    updated_at: datetime = Field(description="When its name, label or metadata changed last.")

    @classmethod
    def of(cls, record: ShapeRecord) -> Self:
        """Make the answer for a stored shape."""
        return cls.model_validate(record, from_attributes=True)


class KnownShape(Shape):
    """A member of the library whose file was sent again."""

    ignored: list[str] = Field(description=_IGNORED, examples=[["label"]])
    updated: list[str] = Field(description="What was sent with the file, and the shape took.", examples=[[]])

    @classmethod
    def of_known(cls, known: Known) -> Self:
        """Make the answer for a shape that was stored already."""
        return cls.model_validate(
            Shape.of(known.shape).model_dump() | {"ignored": list(known.ignored), "updated": list(known.updated)}
        )


class ShapePage(BaseModel):
    """Shapes in the order they were added."""

    items: list[Shape]
    next_cursor: str | None = Field(description="Give it as `cursor` to get the next page; null on the last.")


class ShapeChanges(BaseModel):
    """What to change of a shape; members left out stay."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"label": "cat"}]})

    # by factories, for what is left out is not set to anything, and the document must not say so
    name: str = Field(default_factory=str, min_length=1, max_length=MAX_TEXT)
    label: str | None = Field(default_factory=lambda: None, min_length=1, max_length=MAX_TEXT, examples=["cat"])
    metadata: dict[str, Any] = Field(default_factory=dict)


class JobError(BaseModel):
    """Why a job failed."""

    code: str = Field(description="A stable name for programs.", examples=["mesh_read"])
    message: str = Field(examples=["line 17: three coordinates expected, found '0.1 0.2'"])
    advice: str = ""


class ClassMatch(BaseModel):
    """A class and how far it is from the query."""

    label: str = Field(examples=["cat"])
    distance: float = Field(description="As the classifier has it: its nearest member's by default.", examples=[0.041])
    confidence: float = Field(description="Probability that it is this one, if it is any of them.", examples=[0.97])


class ShapeMatch(BaseModel):
    """A stored shape and its distance from the query."""

    id: Id
    name: str = Field(examples=["cat-03"])
    label: str | None = Field(examples=["cat"])
    distance: float = Field(examples=[0.041])


class Ranking(BaseModel):
    """What a query is and what is like it, best first."""

    measure: str = Field(examples=[DEFAULT_MEASURE])
    classes: list[ClassMatch]
    shapes: list[ShapeMatch]
    known: bool | None = Field(
        description="Whether the query is as near to the best class as its members are to each other: if not, it may "
        "be none of these. Null where the class has too few members to tell."
    )
    warnings: list[str] = Field(
        default_factory=list,  # answers stored by earlier versions have none
        description=f"Of the query. {_WARNINGS}",
    )


class JobSummary(BaseModel):
    """A computation: queued, running, and then succeeded, failed or cancelled for good."""

    id: Id
    kind: JobKind
    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    stage: str = Field(examples=["geodesics"])
    progress: float = Field(ge=0, le=1, examples=[0.42])
    detail: dict[str, float] = Field(
        description="What a running stage tells: `sample` of `samples`, `row` of `rows`, or `iteration` and "
        "`stress`. `seconds` since the job was begun come each second.",
        examples=[{"row": 120, "rows": 300, "seconds": 4.2}],
    )
    position: int | None = Field(description="Jobs that wait before this one; null once it runs.")
    attempts: int = Field(description="How often it was begun; a lost process costs one.")
    error: JobError | None
    shape_id: Id | None = Field(
        description="Of a succeeded upload, the shape it became; of a file, the shape it is made of."
    )
    warnings: list[str] = Field(description=f"Of a succeeded job. {_WARNINGS}")
    ignored: list[str] = Field(description=f"Of an upload whose shape was stored meanwhile. {_IGNORED}")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None

    @classmethod
    def of(cls, record: JobRecord, position: int | None = None) -> Self:
        """Make the answer for a stored job."""
        values = {name: getattr(record, name) for name in cls.model_fields if name != "position"}
        return cls.model_validate(values | {"position": position})


class Job(JobSummary):
    """A computation with its answer."""

    result: Ranking | None = Field(
        description="Of a succeeded query, with the names and labels that its shapes have now."
    )


class JobList(BaseModel):
    """The newest jobs first, without their results."""

    items: list[JobSummary]
    next_cursor: str | None = Field(description="Give it as `cursor` to get the next page; null on the last.")


class Forgotten(BaseModel):
    """The answer where jobs were forgotten."""

    forgotten: int = Field(description="How many jobs were forgotten.", examples=[1200])


class ShapeQuery(BaseModel):
    """A query by a shape that is stored already."""

    model_config = ConfigDict(extra="forbid", strict=True, json_schema_extra=FEWER_PAIRS)

    shape_id: Annotated[Id, Field(min_length=1, max_length=64)]
    measure: MeasureName = DEFAULT_MEASURE
    classifier: ClassifierName = DEFAULT_CLASSIFIER
    k: Whole = Field(10, ge=1, le=1000)


class ClassCount(BaseModel):
    """A class and its size."""

    label: str = Field(examples=["cat"])
    count: int = Field(examples=[6])


class ClassList(BaseModel):
    """The classes of the library."""

    items: list[ClassCount]


class MapItem(BaseModel):
    """A shape and its places."""

    id: Id
    name: str = Field(examples=["cat-03"])
    label: str | None = Field(examples=["cat"])
    point: list[float] = Field(description="By its signature.", examples=[[0.4, -0.1]])
    original: list[float] = Field(description="By its surface as it stands, for comparison.", examples=[[0.2, 0.3]])


class ShapeMap(BaseModel):
    """Shapes as points whose distances are near those of their descriptors: the paper's D_M and Fig. 8."""

    measure: str = Field(examples=[DEFAULT_MEASURE])
    stress: float = Field(description="Eq. 2 of the points: 0 where they have exactly the descriptors' distances.")
    original_stress: float = Field(description="Eq. 2 of the originals.")
    count: int = Field(description="Shapes that could be shown.")
    items: list[MapItem]


class ClassFigures(BaseModel):
    """The queries of one class."""

    label: str = Field(examples=["cat"])
    queries: int
    members: int = Field(description="Shapes of the class.")
    accuracy: float = Field(description="How often the nearest other shape is of the class.")
    nn: float | None
    ft: float | None
    st: float | None
    e: float | None
    dcg: float | None
    map: float | None


class Confusion(BaseModel):
    """Which classes are taken for which."""

    labels: list[str]
    counts: list[list[int]] = Field(description="Shapes by their class (row) and that of the nearest other (column).")


class PrecisionRecall(BaseModel):
    """Mean precision at levels of recall."""

    recall: list[float]
    precision: list[float]


class EvaluationResult(BaseModel):
    """How well stored shapes find their own class among all others, as the Princeton Shape Benchmark measures it."""

    measure: str = Field(examples=[DEFAULT_MEASURE])
    nn: float | None = Field(description="Nearest neighbour.")
    ft: float | None = Field(description="First tier.")
    st: float | None = Field(description="Second tier.")
    e: float | None = Field(description="E-measure, of the first 32.")
    dcg: float | None = Field(description="Discounted cumulative gain.")
    map: float | None = Field(description="Mean average precision.")
    accuracy: float = Field(description="Nearest neighbour over all shapes, those that are alone in their class too.")
    queries: int = Field(description="Shapes asked; of a very large library, evenly chosen ones.")
    unanswered: int
    classes: list[ClassFigures]
    confusion: Confusion | None = Field(description="Null for more than 1000 classes.")
    precision_recall: PrecisionRecall


class Descriptors(BaseModel):
    """A shape's vectors for comparing, by measure."""

    descriptors: dict[str, list[float]]


class Distances(BaseModel):
    """Geodesic distances from one vertex, in units of the file."""

    source: int
    distances: list[float | None] = Field(
        description="One for each vertex of the file; null where unreachable, or not on the simplified surface."
    )
    target: int | None = None
    path: list[Annotated[list[float], Field(min_length=3, max_length=3)]] | None = Field(
        None, description="With a target: the minimal path to it, a polyline on the surface as it was read."
    )


class Capacity(BaseModel):
    """How busy the service is."""

    workers: int
    running: int = Field(description="Jobs in hand, some of them waiting for a process.")
    queued: int
    max_queued: int


class Health(BaseModel):
    """That the service is there."""

    status: Literal["ok"] = "ok"
