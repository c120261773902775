"""Fields of requests that a type of Python does not tell: how OpenAPI documents them, and how they are read.

What is said here and what is accepted must be the same: tests/api/test_contract.py sends what one says and looks
whether the other takes it.
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
from unbend.library.ranking import MOST_PAIRS
from unbend.matching.classification.registry import CLASSIFIERS
from unbend.matching.measures.registry import MEASURES, PAIR_MEASURES, VECTOR_MEASURES
from unbend.mesh.policy import FEWEST_VERTICES, MOST_ROUNDS, Components, Seams
from unbend.signature.parameters import MAX_SAMPLES, MAX_SEED, FirstSample, Scaling

EXAMPLE_ID: Final = "5f2b7c1e9a0d4c3f8e6a1b2c3d4e5f60"

_ID: Final = {"type": "string", "pattern": "^[0-9a-f]{32}$", "examples": [EXAMPLE_ID]}

Id = Annotated[str, WithJsonSchema(_ID)]
"""Of a shape or a job. One of another form is nobody's, and no error of its own."""

ShapeId = Annotated[str, Path(description="Of a stored shape."), WithJsonSchema(_ID)]

JobId = Annotated[str, Path(description="Of a job."), WithJsonSchema(_ID)]


def _with(method: list[JsonValue], **then: JsonValue) -> JsonValue:
    """Return what else must hold where `method` is one of these, as JSON Schema has it."""
    return {
        "if": {"properties": {"method": {"enum": method}}, "required": ["method"]}, "then": {"properties": then}
    }  # fmt: skip


class ParametersFields(BaseModel):
    """What a signature is computed with; what is left out stays at its default."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [{"samples": 300}],
            "allOf": [
                _with(["classical", "fast"], starts={"const": 0}, weights={"enum": ["equal", "area"]}),
                _with(["fast"], weights={"const": "equal"}),
            ],
        },
    )

    samples: Annotated[int, Field(ge=4, le=MAX_SAMPLES)] | Literal["auto"] = Field(
        300, description="Farthest point samples; `auto` doubles them until the spectrum moves by `tolerance` at most."
    )
    dimensions: Annotated[int, Field(ge=1, le=MAX_DIMENSIONS)] | Literal["auto"] = Field(
        3, description="Of the signature's space; `auto` is the fewest within `threshold` by `criterion`."
    )
    method: Method = Field("least_squares", description="How samples are embedded.")
    update: Update = Field("spherical", description="How fast marching crosses a triangle.")
    scaling: Scaling = Field("area", description="What is made 1.")
    first_sample: FirstSample = Field("end", description="Where sampling begins; `seed` draws a `random` vertex.")
    starts: int = Field(0, ge=0, le=MAX_STARTS, description="Further random starts of least squares.")
    seed: int = Field(0, ge=0, le=MAX_SEED, description="Of all that is random.")
    weights: Weighting = Field("equal", description="Of pairs in the stress: 1, 1/d, 1/d^2, or by area.")
    criterion: Criterion = Field("error", description="What `threshold` bounds: eq. 6, or the stress of eq. 2.")
    threshold: float = Field(0.05, gt=0, lt=1, description="For `dimensions` `auto`.")
    tolerance: float = Field(0.02, gt=0, lt=1, description="For `samples` `auto`: share of the spectrum.")


class PolicyFields(BaseModel):
    """How a file is read; what is left out stays at its default."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"components": "bridge"}]})

    components: Components = Field("largest", description="Of several: keep the largest, link them, or refuse.")
    max_vertices: Annotated[int, Field(ge=FEWEST_VERTICES)] | None = Field(
        None, description="Simplify a mesh of more vertices."
    )
    smooth: int = Field(0, ge=0, le=MOST_ROUNDS, description="Rounds of smoothing.")
    seams: Seams = Field("stitch", description="Join boundary edges whose ends coincide, or leave the surface cut.")


def _inline(model: type[BaseModel], description: str) -> dict[str, Any]:
    schema = model.model_json_schema()
    del schema["title"]
    return schema | {"description": description}


_PARAMETERS: Final = _inline(ParametersFields, "What the signature is computed with, as a JSON object.")
_POLICY: Final = _inline(PolicyFields, "How to read the file, as a JSON object.")
_METADATA: Final = {"type": "object", "description": "Anything, as a JSON object.", "examples": [{"scanner": "A"}]}

ParametersText = Annotated[str | None, WithJsonSchema(_PARAMETERS)]
"""JSON text in a form: a part of the type application/json, which is what OpenAPI says an object in a form is."""

PolicyText = Annotated[str | None, WithJsonSchema(_POLICY)]

MetadataText = Annotated[str | None, WithJsonSchema(_METADATA)]

_INSTANT: Final = re.compile(r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)")


def as_instant(value: object) -> object:
    """Return text that may be an instant of RFC 3339, which has an offset; numbers are none."""
    if not isinstance(value, str) or not _INSTANT.fullmatch(value):
        raise ValueError("should be an instant with its offset, such as 2026-01-31T12:00:00Z")
    return value


MeasureName = Annotated[str, Field(json_schema_extra={"enum": list(MEASURES)})]

VectorMeasureName = Annotated[str, Field(json_schema_extra={"enum": list(VECTOR_MEASURES)})]

ClassifierName = Annotated[str, Field(json_schema_extra={"enum": list(CLASSIFIERS)})]

Whole = Annotated[int, BeforeValidator(as_whole)]
"""JSON knows one kind of number: 10.0 is the integer 10 (JSON Schema), also where text and booleans are none."""

FEWER_PAIRS: Final[dict[str, Any]] = {
    "if": {"properties": {"measure": {"enum": list(PAIR_MEASURES)}}, "required": ["measure"]},
    "then": {"properties": {"k": {"maximum": MOST_PAIRS}}},
}
"""Of a query: fewer shapes where each is compared whole."""

MESH_TYPES: Final = ("model/vnd.off", "model/obj", "application/vnd.ply", "model/stl", "model/gltf-binary")
"""What a file may be. It is looked at and not its type, so that any other will do."""

FILE: Final = {
    "type": "string",
    "format": "binary",
    "description": "An off, obj, ply, stl or glb file, whatever the type of its part says.",
    "examples": ["OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"],
}

FILE_ENCODING: Final = {"file": {"contentType": ", ".join(MESH_TYPES)}}
