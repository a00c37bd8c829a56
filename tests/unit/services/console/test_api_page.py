"""The page /docs: everything that the document says, and nothing from elsewhere."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.applications import Starlette
from starlette.testclient import TestClient

from rodeo.text.strict_json import Json
from services.console.actions import ACTIONS
from services.console.api_page import page, route
from services.console.guard import Guard
from services.console.rest import make_api
from tests.unit.services.console.test_guard import ORIGIN, _nobody

CONSOLE: Any = SimpleNamespace(queries=None)


@pytest.fixture(scope="module")
def document() -> Json:
    return make_api(CONSOLE).openapi()


def test_each_operation_has_a_summary_its_models_and_its_errors(document: Json) -> None:
    html = page(document)
    for path, methods in document["paths"].items():
        for operation in methods.values():
            section = html.partition(f'<section id="{operation["operationId"]}">')[2].partition("</section>")[
                0
            ]
            assert path in section and operation["summary"] and operation["description"]
            assert "Errors: 400, 401, 403, 404, 409" in section
            answer = section.rpartition("Answer: ")[2]
            assert "<code>" in answer or "(" in answer, f"{path} says nothing of its answer"
    assert len(ACTIONS) == html.count("<code>POST ")


def test_every_link_leads_somewhere_and_nothing_is_loaded_from_elsewhere(document: Json) -> None:
    html = page(document)
    ids = re.findall(r'id="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]+)"', html)) <= set(ids)
    loaded = re.findall(r'(?:src|href)="([^#"][^"]*)"', html)
    assert all(one.startswith("/") for one in loaded)
    assert "<script" not in html and "style=" not in html


def test_what_the_document_holds_is_text() -> None:
    operation = {
        "operationId": "x",
        "summary": "<b>",
        "responses": {"200": {"description": "<i>", "content": {"text/<u>": {}}}},
        "parameters": [{"name": "<p>", "in": "query", "schema": {"enum": ["<q>"]}}],
    }
    document = {
        "info": {"title": "<t>", "summary": "<s>"},
        "paths": {"/<path>": {"get": operation}},
        "components": {"schemas": {"A": {"description": "<d>", "properties": {"<f>": {"default": "<g>"}}}}},
    }
    html = page(document)
    for tag in ("b", "i", "u", "p>&lt;", "q", "t", "s", "path", "d", "f", "g"):
        assert f"&lt;{tag[0]}" in html
    assert not re.search(r"<(b|i|u|q|t|s|path|d|f|g)>", html)


def test_everybody_may_read_it_under_the_pages_own_policy() -> None:
    accounts: Any = SimpleNamespace(session=_nobody)
    app = Starlette(routes=[route(make_api(CONSOLE))])
    with TestClient(Guard(app, accounts, {ORIGIN}, lambda _client: None), base_url=ORIGIN) as client:
        answer = client.get("/docs")
    assert answer.status_code == 200 and "/api/events" in answer.text
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
