"""Files of tasks for people who are logged in; the guard has seen their session."""

# No postponed annotations: FastAPI reads those of functions that are made inside functions.

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse, JSONResponse, Response

from rodeo.bus import queries
from rodeo.display.earnings import as_csv
from rodeo.person.photos import kept
from rodeo.vision.images import media_type
from services.console.money import transfers_csv
from services.console.pages.frame import Console
from services.console.solids import solids


def router(console: Console) -> APIRouter:
    """GET /files/proof/<task>?attempt=<number>, /files/photo/<name>, /files/transfers.csv?account=<name>,
    /files/earnings.csv and /files/lab.json (`solids`). They raise RodeoError."""
    routes = APIRouter(include_in_schema=False)

    def copy(task_id: int, attempt: int | None = None) -> Iterator[Path]:
        with console.queries.proof(console.queries.evidence(task_id, attempt)) as path:
            yield path

    @routes.get("/files/proof/{task_id}")
    def proof(task_id: int, copy: Annotated[Path, Depends(copy)]) -> Response:
        return FileResponse(copy, filename=f"task-{task_id}.mcap", media_type="application/octet-stream")

    @routes.get("/files/photo/{name}")
    def photo(name: str) -> Response:
        shown = kept(console.site, name)
        return Response(shown, media_type=media_type(shown), headers={"Cache-Control": "private, immutable"})

    drawn = cache(partial(solids, console.site))

    @routes.get("/files/lab.json")
    def lab() -> Response:
        return JSONResponse(drawn(), headers={"Cache-Control": "private, max-age=3600"})

    @routes.get("/files/transfers.csv")
    def transfers(account: str) -> Response:
        asked = partial(console.queries.ask, queries.TRANSFERS, account=account, limit=queries.MAX_PAGE)
        found = queries.entries(lambda offset: asked(offset=offset).transfers)
        return _csv("transfers", transfers_csv(found))

    @routes.get("/files/earnings.csv")
    def earnings() -> Response:
        return _csv("earnings", as_csv(console.queries.earnings()))

    return routes


def _csv(name: str, text: str) -> Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}.csv"'}
    return Response(text, media_type="text/csv", headers=headers)
