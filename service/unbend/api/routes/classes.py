"""What the library holds."""

from __future__ import annotations

from fastapi import APIRouter

from unbend.api.models import ClassCount, ClassList
from unbend.api.service import ServiceDependency

router = APIRouter(prefix="/classes", tags=["library"])


@router.get("")
def list_classes(service: ServiceDependency) -> ClassList:
    """List the classes and how many shapes each has."""
    return ClassList(items=[ClassCount(label=label, count=count) for label, count in service.library.labels().items()])
