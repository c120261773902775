"""Types of request fields, with their schemas in OpenAPI.

The schemas must match the values that the service accepts: tests/api/test_contract.py sends values from the schemas.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Final, Literal

from fastapi import Path
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, JsonValue, WithJsonSchema

from unbend.embedding.dimension import MAX_DIMENSIONS
from unbend.embedding.embed import MAX_STARTS, Criterion, Method
from unbend.embedding.weighting import Weighting
from unbend.geodesics.distances import Update
from unbend.jsons import as_whole
from unbend.library.requests import MAX_PAIRS, RANKING_MEASURES
from unbend.matching.classification.registry import CLASSIFIERS, DEFAULT_CLASSIFIER
from unbend.matching.measures.registry import PAIR_MEASURES, VECTOR_MEASURES
from unbend.matching.partial import PART_MEASURES
from unbend.mesh.formats import FORMATS
from unbend.mesh.policy import FEWEST_VERTICES, MOST_ROUNDS, Components, Seams
from unbend.signature.parameters import MAX_SAMPLES, MAX_SEED, FirstSample, Scaling

CURSOR: Final = r"^[0-9]{1,18}$"
SHA256: Final = r"^[0-9a-f]{64}$"
EXACT_ID: Final = r"^[0-9a-f]{32}$"
VISIBLE_NAME: Final = r"^[\x21-\x7e]{1,255}$"

PATTERNS: Final = {
    CURSOR: "should be the next_cursor of the page before",
    SHA256: "should be a SHA-256 in 64 hexadecimal digits, in lower case",
    EXACT_ID: "should be an id in 32 hexadecimal digits, in lower case",
    VISIBLE_NAME: "should have 1 to 255 visible characters of ASCII",
}
"""Patterns of text, and what they mean."""

EXAMPLE_ID: Final = "5f2b7c1e9a0d4c3f8e6a1b2c3d4e5f60"

_ID: Final = {"type": "string", "pattern": EXACT_ID, "examples": [EXAMPLE_ID]}

Id = Annotated[str, WithJsonSchema(_ID)]
"""Id of a shape or a job. A malformed id gets 404, like any unknown id."""

ShapeId = Annotated[str, Path(description="Id of a stored shape."), WithJsonSchema(_ID)]

JobId = Annotated[str, Path(description="Id of a job."), WithJsonSchema(_ID)]


def _with(method: list[JsonValue], **then: JsonValue) -> JsonValue:
    """Return a JSON Schema rule: if `method` has one of these values, the fields in `then` must match their schemas."""
    return {
        "if": {"properties": {"method": {"enum": method}}, "required": ["method"]}, "then": {"properties": then}
    }  # fmt: skip


class ParametersFields(BaseModel):
    """Parameters of a signature; missing fields have their defaults."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "allOf": [
                _with(["classical", "fast"], starts={"const": 0}, weights={"enum": ["equal", "area"]}),
                _with(["fast"], weights={"const": "equal"}),
            ],
        },
    )

    samples: Annotated[int, Field(ge=4, le=MAX_SAMPLES)] | Literal["auto"] = Field(
        300,
        description="Farthest point samples; `auto` doubles them until the spectrum changes by `tolerance` at most.",
    )
    dimensions: Annotated[int, Field(ge=1, le=MAX_DIMENSIONS)] | Literal["auto"] = Field(
        3,
        description="Dimensions of the signature; `auto` chooses the fewest whose `criterion` is at most `threshold`.",
    )
    method: Method = Field("least_squares", description="How samples are embedded.")
    update: Update = Field("spherical", description="How fast marching crosses a triangle.")
    scaling: Scaling = Field("area", description="Quantity that is scaled to 1.")
    first_sample: FirstSample = Field("end", description="Where sampling begins; `seed` draws a `random` vertex.")
    starts: int = Field(0, ge=0, le=MAX_STARTS, description="Further random starts of least squares.")
    seed: int = Field(0, ge=0, le=MAX_SEED, description="Seed of all random choices.")
    weights: Weighting = Field("equal", description="Weights of pairs in the stress: 1, 1/d, 1/d^2, or by area.")
    criterion: Criterion = Field(
        "error", description="Quantity that `threshold` limits: eq. 6, or the stress of eq. 2."
    )
    threshold: float = Field(0.05, gt=0, lt=1, description="Limit of `criterion` if `dimensions` is `auto`.")
    tolerance: float = Field(
        0.02, gt=0, lt=1, description="If `samples` is `auto`: the share by which the spectrum may change."
    )


class PolicyFields(BaseModel):
    """Policy for reading a file; missing fields have their defaults."""

    model_config = ConfigDict(extra="forbid")

    components: Components = Field(
        "largest", description="Of several components: keep the largest, link all, or refuse the mesh."
    )
    max_vertices: Annotated[int, Field(ge=FEWEST_VERTICES)] | None = Field(
        None, description="Simplify a mesh of more vertices."
    )
    smooth: int = Field(0, ge=0, le=MOST_ROUNDS, description="Rounds of smoothing.")
    seams: Seams = Field("stitch", description="Join boundary edges whose ends coincide, or leave the surface cut.")


_NO_EXAMPLE: Final[list[JsonValue]] = [{}]
"""An empty example. Without it, the form of /docs fills in a value of its own, and "Try it out" sends that value."""


def _inline(model: type[BaseModel], description: str) -> dict[str, Any]:
    schema = model.model_json_schema()
    del schema["title"]
    return schema | {"description": description, "examples": _NO_EXAMPLE}


_PARAMETERS: Final = _inline(ParametersFields, "Parameters of the signature, as a JSON object.")
_POLICY: Final = _inline(PolicyFields, "How to read the file, as a JSON object.")
_METADATA: Final = {"type": "object", "description": "Any JSON object.", "examples": _NO_EXAMPLE}

ParametersText = Annotated[str | None, WithJsonSchema(_PARAMETERS)]
"""JSON text in a form. OpenAPI describes an object in a form as a part with the type application/json."""

PolicyText = Annotated[str | None, WithJsonSchema(_POLICY)]

MetadataText = Annotated[str | None, WithJsonSchema(_METADATA)]

_INSTANT: Final = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)")


def as_instant(value: object) -> object:
    """Return text in the form of an RFC 3339 time with an offset; ValueError for anything else."""
    if not isinstance(value, str) or not _INSTANT.fullmatch(value):
        raise ValueError("should be an instant with its offset, such as 2026-01-31T12:00:00Z")
    return value


MeasureName = Annotated[str, Field(json_schema_extra={"enum": list(RANKING_MEASURES)})]

VectorMeasureName = Annotated[str, Field(json_schema_extra={"enum": list(VECTOR_MEASURES)})]

ClassifierName = Annotated[str, Field(json_schema_extra={"enum": list(CLASSIFIERS)})]

MetadataScalar = str | float | bool | None
"""A value of metadata that a query can ask for."""

EXACT: Final = "Compare every shape, even if the database has an approximate index."
METADATA_FILTER: Final = "Only shapes whose metadata have these members, with these values."

_FILTER: Final = {
    "type": "object",
    "description": METADATA_FILTER,
    "additionalProperties": {"anyOf": [{"type": kind} for kind in ("string", "number", "boolean", "null")]},
    "examples": _NO_EXAMPLE,
}

FilterText = Annotated[str | None, WithJsonSchema(_FILTER)]
"""JSON text in a form, as `MetadataText`."""

Whole = Annotated[int, BeforeValidator(as_whole)]
"""An integer in JSON, for strict models, which refuse text and booleans. 10.0 equals 10 (JSON Schema)."""

QUERY_CONDITIONS: Final[dict[str, Any]] = {
    "allOf": [
        {
            "if": {"properties": {"measure": {"enum": list(PAIR_MEASURES)}}, "required": ["measure"]},
            "then": {"properties": {"k": {"maximum": MAX_PAIRS}}},
        },
        {
            "if": {"properties": {"measure": {"enum": list(PART_MEASURES)}}, "required": ["measure"]},
            "then": {"properties": {"classifier": {"const": DEFAULT_CLASSIFIER}}},
        },
    ]
}
"""Conditions on a query: a lower maximum of `k` for measures of whole shapes, one classifier for measures of parts."""

FILE: Final = {
    "type": "string",
    "format": "binary",
    "description": "An off, obj, ply, stl or glb file; the media type of its part is ignored.",
    "examples": ["OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"],
}

FILE_ENCODING: Final = {"file": {"contentType": ", ".join(FORMATS.values())}}
"""Media types of mesh files. Any other type is accepted too, because the content decides."""
