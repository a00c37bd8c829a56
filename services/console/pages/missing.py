"""What people see at an address that has no page, and where a page could not be made."""

from __future__ import annotations

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from nicegui import Client, ui
from nicegui import app as nicegui_app
from starlette.responses import PlainTextResponse, Response

from services.console.pages import frame, widgets
from services.console.pages.frame import Console


def register(console: Console) -> None:
    def explain(request: Request, title: str, text: str, status: int) -> Response:
        if request.state.session is None:  # asked for one of the framework's files, which need no login
            return PlainTextResponse(title, status)
        with Client(ui.page(""), request=request) as client:
            with frame.page(console, title, ""):
                widgets.notice(text, bad=True)
            return client.build_response(request, status)

    @nicegui_app.exception_handler(404)
    @nicegui_app.exception_handler(RequestValidationError)
    async def no_page(request: Request, _error: Exception) -> Response:
        return explain(request, "No such page", "This address has no page. Choose one from the menu.", 404)

    @nicegui_app.exception_handler(Exception)
    async def no_answer(request: Request, _error: Exception) -> Response:
        # The framework's own page would show the error's text, whatever that holds. It is in the log.
        return explain(
            request,
            "This page failed to load",
            "Reload it. If that does not help, see the log of the process console.",
            500,
        )
