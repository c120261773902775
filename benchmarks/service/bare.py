"""A minimal FastAPI endpoint, which validates a record with a model at its start and returns that record."""

from __future__ import annotations

import json
import sys
from typing import Any

import uvicorn
from fastapi import FastAPI

from unbend.api.schema.models import Shape

app = FastAPI()
record: dict[str, Any] = json.loads(sys.argv[1])
shape = Shape.model_validate(record)


@app.get("/")
async def read() -> Shape:
    return shape


uvicorn.run(app, host="127.0.0.1", port=0, access_log=False, http="h11", loop="asyncio")  # like the service
