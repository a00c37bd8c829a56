"""The page /docs: what programs can ask for under /api, made from its OpenAPI document without a script."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from jinja2 import Template
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from rodeo.text.strict_json import Json

_PAGE = Template((Path(__file__).parent / "static" / "api.html").read_text(), autoescape=True)
_LIMITS = {
    "at least": "minimum",
    "at most": "maximum",
    "more than": "exclusiveMinimum",
    "less than": "exclusiveMaximum",
    "characters at most:": "maxLength",
    "fits": "pattern",
    "by default": "default",
}
"""Words of a limit -> its name in JSON Schema."""


def route(api: FastAPI) -> Route:
    """GET /docs. Everybody may read it, as they may the document."""
    made = cache(lambda: page(api.openapi()))

    def show(_request: Request) -> Response:
        return HTMLResponse(made())

    return Route("/docs", show)


def page(document: Json) -> str:
    """Every operation with its parameters, fields, answer and errors, and every model that these name."""
    operations = [
        (method.upper(), path, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    ]
    acts = [one for one in operations if "actions" in one[2].get("tags", [])]
    return _PAGE.render(
        info=document["info"],
        reads=[one for one in operations if one not in acts],
        acts=acts,
        models=document["components"]["schemas"],
        said=_said,
    )


def _said(*schemas: Json) -> str:
    """The description, limits and default."""
    told = next((one["description"] for one in schemas if "description" in one), "")
    limits = {word: value for word, name in _LIMITS.items() for value in _values(schemas[-1], name)}
    said = [told, *(f"{word} {value}" for word, value in limits.items())]
    return "; ".join(filter(None, said))


def _values(schema: Json, name: str) -> Iterator[Any]:
    for one in (schema, *schema.get("anyOf", [])):
        if one.get(name) is not None:
            yield one[name]
            return
