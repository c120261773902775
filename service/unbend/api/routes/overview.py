"""The library as a whole: its classes, a map of its shapes, and how well it finds its own."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from unbend.api.fields import ParametersText, VectorMeasureName
from unbend.api.links import members_of_class, shape_links
from unbend.api.models import ClassCount, ClassList, EvaluationResult, ShapeMap
from unbend.api.problems import pointing_at, problem_responses
from unbend.api.service import ServiceDependency
from unbend.jobs.worker import library_evaluation, library_map
from unbend.library.overview import MAP_LIMIT, MapDistance, Shown
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure
from unbend.signature.parameters import Parameters

router = APIRouter(tags=["library"])

MeasureQuery = Annotated[VectorMeasureName, Query(description="How signatures are compared.")]
ParametersQuery = Annotated[ParametersText, Query(description="A JSON object; shapes stored with others take no part.")]


@router.get("/classes", responses={200: {"links": members_of_class()}})
def list_classes(service: ServiceDependency) -> ClassList:
    """List the classes and how many shapes each has."""
    return ClassList(items=[ClassCount(label=label, count=count) for label, count in service.library.labels().items()])


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
        int, Query(ge=1, le=20_000, description="Of more shapes, evenly chosen ones are shown.")
    ] = MAP_LIMIT,
    distance: Annotated[
        MapDistance, Query(description="Sums of absolute differences, or of squared ones: the paper's D_M.")
    ] = "l1",
) -> ShapeMap:
    """Place the stored shapes so that those alike are near each other: by their signatures, and as they stand."""
    chosen, wanted = _measure(measure), _parameters(parameters)
    shown = Shown(dimensions, limit, distance)
    found = await service.runner.call(library_map, service.library.store.url, chosen, wanted, shown, lane="large")
    return ShapeMap.model_validate(found)


@router.get("/evaluation", responses=problem_responses(409, 422, 429, 504, 507))
async def get_evaluation(
    service: ServiceDependency, measure: MeasureQuery = DEFAULT_MEASURE, parameters: ParametersQuery = None
) -> EvaluationResult:
    """Ask every labelled shape of all others, and say how often and how early they find their class."""
    chosen, wanted = _measure(measure), _parameters(parameters)
    found = await service.runner.call(library_evaluation, service.library.store.url, chosen, wanted, lane="large")
    return EvaluationResult.model_validate({"measure": measure, **found})


def _measure(name: str) -> str:
    with pointing_at("query.measure"):
        return get_vector_measure(name).name


def _parameters(text: str | None) -> Parameters | None:
    with pointing_at("query.parameters"):
        return None if text is None else Parameters.from_json(text)
