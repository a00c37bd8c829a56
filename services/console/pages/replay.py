"""Recordings side by side: attempts at tasks, or files that are dropped on the page."""

from __future__ import annotations

import re
import tempfile
from functools import partial
from pathlib import Path
from urllib.parse import urlencode

from nicegui import ui
from nicegui.events import UploadEventArguments

from rodeo.evidence.proof import open_proof
from rodeo.text.strict_json import Json
from services.console.errors import UnknownFile
from services.console.guard import MAX_BODY_BYTES
from services.console.lab_map import LabViews
from services.console.pages import frame, widgets
from services.console.pages.frame import Console
from services.console.queries import Evidence
from services.console.replay import track

SIDES = ("left", "right")
_MAX_BYTES = MAX_BODY_BYTES - (1 << 20)
"""Most bytes of a file that is dropped: the guard counts what is around it, too."""
_NAMED = re.compile(r"(\d{1,9})(?:\.(\d{1,3}))?")


def register(console: Console) -> None:
    @frame.at(console, "/replay")
    def replay(left: str = "", right: str = "") -> None:
        with frame.page(console, "Replay", "/replay"):
            wanted = {"left": left, "right": right}
            with ui.element("div").classes("grid"):
                for side in SIDES:
                    _Side(console, side, wanted)


def track_of(console: Console, evidence: Evidence) -> Json:
    """The recording as `LabReplay` shows it, with its report's checks. Raises UnknownFile, EvidenceError."""
    report = console.queries.report(evidence) if evidence.report_sha256 else None
    with console.queries.proof(evidence) as path:
        return track(open_proof(path), console.site, report)


class _Side:
    """One recording; `wanted` is what both sides show, as the page's address names it."""

    def __init__(self, console: Console, side: str, wanted: dict[str, str]) -> None:
        self._console, self._side, self._wanted = console, side, wanted
        with widgets.card(side.capitalize(), "span-6"):
            with ui.element("div").classes("filters"):
                named = ui.input("Task, or task.attempt", value=wanted[side]).props("outlined dense")
                show = partial(self._choose, named)
                named.on("keydown.enter", show)
                ui.button("Show", on_click=show).props(f'outline dense aria-label="Show on the {side}"')
                widgets.FileDrop(
                    "or drop a recording here",
                    ".mcap",
                    self._dropped,
                    max_file_size=_MAX_BYTES,
                    on_rejected=lambda: ui.notify(f"At most {_MAX_BYTES >> 20} MB", type="warning"),
                )
            self._told = widgets.Text("p", "", "soft").props('aria-live="polite"')
            self._views = LabViews(console.lab, f"the {side} recording")
            self._views.element.visible = False
        if wanted[side]:
            ui.timer(0.1, show, once=True)

    async def _choose(self, named: ui.input) -> None:
        text = str(named.value or "").strip()
        if (recording := await frame.asked(self._asked_for, text)) is None:
            return
        self._wanted[self._side] = text
        ui.navigate.history.replace(f"/replay?{urlencode(self._wanted)}")
        self._show(recording, f"Task {text}")

    def _asked_for(self, text: str) -> Json:
        found = _NAMED.fullmatch(text)
        if found is None:
            raise UnknownFile("enter the number of a task, or of a task and an attempt: 7 or 7.2")
        attempt = None if found[2] is None else int(found[2])
        return track_of(self._console, self._console.queries.evidence(int(found[1]), attempt))

    async def _dropped(self, event: UploadEventArguments) -> None:
        if (recording := await frame.asked(self._opened, await event.file.read())) is None:
            return
        # Only its own seals were checked: no chain knows this file.
        self._show(recording, f"{event.file.name[:80]}: sealed; nobody has checked it")

    def _opened(self, data: bytes) -> Json:
        with tempfile.TemporaryDirectory(prefix="rodeo-dropped-") as folder:
            path = Path(folder) / "dropped.mcap"
            path.write_bytes(data)
            return track(open_proof(path), self._console.site)

    def _show(self, recording: Json, told: str) -> None:
        self._told.set_text(told)
        self._views.element.visible = True
        self._views.replay.show(recording)
