"""Overviews of the library: classes, the map of shapes, and the evaluation of retrieval."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from unbend.api.schema.fields import ParametersText, VectorMeasureName
from unbend.api.schema.links import members_of_class, shape_links
from unbend.api.schema.models import ClassCount, ClassList, EvaluationResult, ShapeMap
from unbend.api.schema.problems import pointing_at, problem_responses
from unbend.api.server.service import ServiceDependency
from unbend.jobs.worker import library_evaluation, library_map
from unbend.library.search.overview import MAP_LIMIT, MapOptions
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure
from unbend.results.maps import MapDistance
from unbend.signature.parameters import Parameters

router = APIRouter(tags=["library"])

MeasureQuery = Annotated[VectorMeasureName, Query(description="Measure that compares the signatures.")]
ParametersQuery = Annotated[
    ParametersText, Query(description="A JSON object; only shapes with these parameters take part.")
]


@router.get("/classes", responses={200: {"links": members_of_class()}})
def list_classes(service: ServiceDependency) -> ClassList:
    """List the classes with their numbers of shapes."""
    classes = [ClassCount(label=label, count=count) for label, count in service.library.labels().items()]
    return ClassList(items=classes, shapes=service.library.count())


@router.get(
    "/map",
    responses={
        200: {"links": shape_links("$response.body#/items/0/id")},
        **problem_responses(422, 429, 504, 507),
    },
)
async def get_map(
    service: ServiceDependency,
    measure: MeasureQuery = DEFAULT_MEASURE,
    parameters: ParametersQuery = None,
    dimensions: Annotated[int, Query(ge=1, le=3)] = 2,
    limit: Annotated[
        int,
        Query(
            ge=1,
            le=20_000,
            description="Largest number of shapes on the map. If there are more, the map shows a selection, spread "
            "evenly over the order in which they were added.",
        ),
    ] = MAP_LIMIT,
    distance: Annotated[
        MapDistance, Query(description="Sum of absolute differences, or of squared differences as in the paper's D_M.")
    ] = "l1",
) -> ShapeMap:
    """Embed the stored shapes so that similar shapes are near each other, by signature and, for comparison, surface."""
    chosen, wanted = _measure(measure), _parameters(parameters)
    options = MapOptions(dimensions, limit, distance)
    found = await service.runner.call(library_map, service.library.address, chosen, wanted, options, lane="large")
    return ShapeMap.model_validate(found)


@router.get("/evaluation", responses=problem_responses(409, 422, 429, 504, 507))
async def get_evaluation(
    service: ServiceDependency, measure: MeasureQuery = DEFAULT_MEASURE, parameters: ParametersQuery = None
) -> EvaluationResult:
    """Query the library with every labelled shape, and return how well the rankings find its class."""
    chosen, wanted = _measure(measure), _parameters(parameters)
    found = await service.runner.call(library_evaluation, service.library.address, chosen, wanted, lane="large")
    return EvaluationResult.model_validate(found)


def _measure(name: str) -> str:
    with pointing_at("query.measure"):
        return get_vector_measure(name).name


def _parameters(text: str | None) -> Parameters | None:
    with pointing_at("query.parameters"):
        return None if text is None else Parameters.from_json(text)
