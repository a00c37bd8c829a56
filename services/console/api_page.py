"""The page /docs: what programs can ask for under /api, made from its OpenAPI document without a script."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from fastapi import FastAPI
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import Route

from rodeo.text.strict_json import Json

_PAGE = Template((Path(__file__).parent / "static" / "api.html").read_text())
_SCHEMA = "#/components/schemas/"


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
    reads = [one for one in operations if "actions" not in one[2].get("tags", [])]
    acts = [one for one in operations if one not in reads]
    errors = reads[0][2]["responses"].items()
    models = document["components"]["schemas"]
    return _PAGE.substitute(
        title=escape(document["info"]["title"]),
        summary=escape(document["info"]["summary"]),
        contents="".join(_entry(path, operation) for _, path, operation in operations),
        errors=_table(("Status", "Meaning"), ((s, said["description"]) for s, said in errors if s != "200")),
        reads="".join(_operation(*one) for one in reads),
        acts="".join(_operation(*one) for one in acts),
        models="".join(_model(name, schema) for name, schema in sorted(models.items())),
    )


def _entry(path: str, operation: Json) -> str:
    return f'<li><a href="#{operation["operationId"]}">{escape(path)}</a> {escape(operation["summary"])}</li>'


def _operation(method: str, path: str, operation: Json) -> str:
    answered = ", ".join(status for status in operation["responses"] if status != "200")
    return (
        f'<section id="{operation["operationId"]}"><h3><code>{method} /api{escape(path)}</code></h3>'
        f"<p><strong>{escape(operation['summary'])}.</strong> {escape(operation.get('description', ''))}</p>"
        f"{_parameters(operation.get('parameters', []))}{_body(operation)}"
        f"<p>Answer: {_answer(operation['responses']['200'])}. Errors: {answered}.</p></section>"
    )


def _parameters(parameters: list[Json]) -> str:
    if not parameters:
        return ""
    rows = (
        (one["name"], one["in"], _Html(_type(one["schema"])), _required(one), _said(one, one["schema"]))
        for one in parameters
    )
    return _table(("Parameter", "In", "Type", "", "Meaning"), rows)


def _body(operation: Json) -> str:
    if "requestBody" not in operation:
        return ""
    (content,) = operation["requestBody"]["content"].values()
    return f"<p>Body: {_type(content['schema'])}.</p>"


def _answer(response: Json) -> str:
    ((kind, content),) = response["content"].items()
    schema = content.get("itemSchema") or content.get("schema")
    of_type = f" ({escape(kind)})" if kind != "application/json" else ""
    return (escape(response["description"]) if schema is None else _type(schema)) + of_type


def _model(name: str, schema: Json) -> str:
    needed = set(schema.get("required", []))
    rows = (
        (field, _Html(_type(one)), "required" if field in needed else "", _said(one, one))
        for field, one in schema.get("properties", {}).items()
    )
    fields = _table(("Field", "Type", "", "Meaning"), rows) if "properties" in schema else _type(schema)
    said = f"<p>{escape(schema['description'])}</p>" if "description" in schema else ""
    return f'<section id="{escape(name)}"><h3><code>{escape(name)}</code></h3>{said}{fields}</section>'


def _type(schema: Json) -> str:
    """The type in HTML, with links to models."""
    if "$ref" in schema:
        name = escape(schema["$ref"].removeprefix(_SCHEMA))
        return f'<a href="#{name}"><code>{name}</code></a>'
    for several in ("anyOf", "oneOf", "allOf"):
        if several in schema:
            return " or ".join(dict.fromkeys(_type(one) for one in schema[several]))
    if "enum" in schema or "const" in schema:
        return ", ".join(
            f"<code>{escape(str(one))}</code>" for one in schema.get("enum", [schema.get("const")])
        )
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    return escape(str(schema.get("format") or schema.get("type") or "anything"))


def _said(*schemas: Json) -> str:
    """The description, limits and default."""
    told = next((one["description"] for one in schemas if "description" in one), "")
    limits = {word: value for word, name in _LIMITS.items() for value in _values(schemas[-1], name)}
    said = [told, *(f"{word} {value}" for word, value in limits.items())]
    return "; ".join(filter(None, said))


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


def _values(schema: Json, name: str) -> Iterator[Any]:
    for one in (schema, *schema.get("anyOf", [])):
        if one.get(name) is not None:
            yield one[name]
            return


def _required(parameter: Json) -> str:
    return "required" if parameter.get("required") else ""


class _Html(str):
    """HTML that was made here."""


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    cells = "".join(f'<th scope="col">{escape(one)}</th>' if one else "<td></td>" for one in head)
    lines = ((one if isinstance(one, _Html) else escape(str(one)) for one in row) for row in rows)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in line)}</tr>" for line in lines)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table>"
