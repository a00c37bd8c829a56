"""Files of tasks for people who are logged in; the guard has seen their session."""

# No postponed annotations: FastAPI reads those of functions that are made inside functions.

import tempfile
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse, JSONResponse, Response

from rodeo.bus import queries
from rodeo.display.earnings import as_csv
from rodeo.errors import RodeoError
from services.console.money import transfers_csv
from services.console.pages.frame import Console
from services.console.rest import status_of
from services.console.solids import solids

_PAGE = 500


def router(console: Console) -> APIRouter:
    """GET /files/proof/<task>?attempt=<number>, /files/transfers.csv?account=<name>, /files/earnings.csv and
    /files/lab.json (`solids`)."""
    routes = APIRouter(include_in_schema=False)

    def folder() -> Iterator[Path]:
        with tempfile.TemporaryDirectory(prefix="rodeo-proof-") as path:
            yield Path(path)

    @routes.get("/files/proof/{task_id}")
    def proof(task_id: int, folder: Annotated[Path, Depends(folder)], attempt: int | None = None) -> Response:
        try:
            copy = console.queries.proof(console.queries.evidence(task_id, attempt), folder)
        except RodeoError as error:
            return JSONResponse(error.to_json(), status_of(error))
        return FileResponse(copy, filename=f"task-{task_id}.mcap", media_type="application/octet-stream")

    drawn = cache(partial(solids, console.site))

    @routes.get("/files/lab.json")
    def lab() -> Response:
        try:
            return JSONResponse(drawn(), headers={"Cache-Control": "private, max-age=3600"})
        except RodeoError as error:
            return JSONResponse(error.to_json(), status_of(error))

    @routes.get("/files/transfers.csv")
    def transfers(account: str) -> Response:
        try:
            found = list(_transfers(console, account))
        except RodeoError as error:
            return JSONResponse(error.to_json(), status_of(error))
        headers = {"Content-Disposition": 'attachment; filename="transfers.csv"'}
        return Response(transfers_csv(found), media_type="text/csv", headers=headers)

    @routes.get("/files/earnings.csv")
    def earnings() -> Response:
        try:
            found = as_csv(console.queries.earnings())
        except RodeoError as error:
            return JSONResponse(error.to_json(), status_of(error))
        headers = {"Content-Disposition": 'attachment; filename="earnings.csv"'}
        return Response(found, media_type="text/csv", headers=headers)

    return routes


def _transfers(console: Console, account: str) -> Iterator[queries.Transfer]:
    """All transfers of the account, newest first, asked page by page."""
    offset = 0
    while True:
        page = console.queries.ask(queries.TRANSFERS, account=account, limit=_PAGE, offset=offset).transfers
        yield from page
        offset += len(page)
        if len(page) < _PAGE:
            return
