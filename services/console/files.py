"""Files of tasks for people who are logged in; the guard has seen their session."""

# No postponed annotations: FastAPI reads those of functions that are made inside functions.

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse, JSONResponse, Response

from rodeo.errors import RodeoError
from services.console.pages.frame import Console
from services.console.rest import status_of


def router(console: Console) -> APIRouter:
    """GET /files/proof/<task>."""
    routes = APIRouter(include_in_schema=False)

    def folder() -> Iterator[Path]:
        with tempfile.TemporaryDirectory(prefix="rodeo-proof-") as path:
            yield Path(path)

    @routes.get("/files/proof/{task_id}")
    def proof(task_id: int, folder: Annotated[Path, Depends(folder)]) -> Response:
        try:
            copy = console.reads.proof(console.reads.task(task_id), folder)
        except RodeoError as error:
            return JSONResponse(error.to_json(), status_of(error))
        return FileResponse(copy, filename=f"task-{task_id}.mcap", media_type="application/octet-stream")

    return routes
