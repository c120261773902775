"""The library as a whole: its classes, a map of its shapes, and how well it finds its own."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from unbend.api.models import ClassCount, ClassList, EvaluationResult, ShapeMap
from unbend.api.problems import problem_responses
from unbend.api.service import ServiceDependency
from unbend.jobs.worker import library_evaluation, library_map
from unbend.library.overview import MAP_LIMIT
from unbend.matching.measures import DEFAULT_MEASURE
from unbend.signature.parameters import Parameters

router = APIRouter(tags=["library"])

MeasureQuery = Annotated[str, Query(description="How signatures are compared.")]
ParametersQuery = Annotated[
    str | None,
    Query(description="A JSON object; shapes stored with others take no part.", examples=['{"samples": 300}']),
]


@router.get("/classes")
def list_classes(service: ServiceDependency) -> ClassList:
    """List the classes and how many shapes each has."""
    return ClassList(items=[ClassCount(label=label, count=count) for label, count in service.library.labels().items()])


@router.get("/map", responses=problem_responses(422))
async def get_map(
    service: ServiceDependency,
    measure: MeasureQuery = DEFAULT_MEASURE,
    parameters: ParametersQuery = None,
    dimensions: Annotated[int, Query(ge=1, le=3)] = 2,
    limit: Annotated[
        int, Query(ge=1, le=20_000, description="Of more shapes, evenly chosen ones are shown.")
    ] = MAP_LIMIT,
) -> ShapeMap:
    """Place the stored shapes so that those alike are near each other: by their signatures, and as they stand."""
    chosen = None if parameters is None else Parameters.from_json(parameters)
    found = await service.runner.call(library_map, service.library.store.url, measure, chosen, dimensions, limit)
    return ShapeMap.model_validate(found)


@router.get("/evaluation", responses=problem_responses(422))
async def get_evaluation(
    service: ServiceDependency, measure: MeasureQuery = DEFAULT_MEASURE, parameters: ParametersQuery = None
) -> EvaluationResult:
    """Ask every labelled shape of all others, and say how often and how early they find their class."""
    chosen = None if parameters is None else Parameters.from_json(parameters)
    found = await service.runner.call(library_evaluation, service.library.store.url, measure, chosen)
    return EvaluationResult.model_validate({"measure": measure, **found})
