"""The proof of one attempt at a task, who sealed it, and what its judge found."""

from __future__ import annotations

from decimal import Decimal
from functools import partial

from nicegui import ui

from rodeo.bus.queries import DEVICES, OwnedDevice
from rodeo.display.formatting import explain, number
from rodeo.errors import RodeoError
from rodeo.text.strict_json import Json
from services.console.attempts import Attempt
from services.console.pages import frame, widgets
from services.console.pages.frame import Console
from services.console.pages.verdict import draw_report
from services.console.queries import Seal

_ORACLES_REPORT = "Oracle's report"


class TaskEvidence:
    """Cards of a task's page: the proof is drawn here and now, report and pictures by `report_card`."""

    def __init__(self, console: Console, task_id: int) -> None:
        self._console = console
        self._task_id = task_id
        self.shown: Attempt | None = None
        """The attempt that is shown."""
        self._verdict = ""
        """On that attempt, in words, and by whom."""
        with widgets.card("Proof", "span-6"):
            self._proof = widgets.Section(self._draw_proof).waiting()

    def report_card(self) -> None:
        with widgets.card(_ORACLES_REPORT) as self._report_head:
            self._report = widgets.Section(self._draw_report).waiting()
        with ui.element("div") as self._album, widgets.card("Pictures"):
            self._pictures = widgets.Section(widgets.pictures)
        self._album.visible = False

    async def load(self, shown: Attempt | None, verdict: str) -> None:
        """Report, proof and who sealed it; `verdict` in words."""
        self.shown, self._verdict = shown, verdict
        if shown is None:
            self._report.show(None, "The oracle has not judged a proof of this task yet.")
            self._proof.show(None, {})
            return
        if shown.report_sha256 is None:
            ruled = shown.verdict or shown.standing
            self._report.show(None, "No report." if ruled else "Nobody has judged this proof yet.")
        else:
            try:
                self._report.show(await frame.ask(self._console.queries.report, shown), "")
            except RodeoError as error:
                self._report.show(None, explain(error))
        try:
            seal = await frame.ask(self._console.queries.seal, shown)
            devices = (await frame.ask(self._console.queries.ask, DEVICES)).devices
            taken = await frame.ask(self._console.queries.pictures, shown)
        except RodeoError as error:
            self._proof.show(shown, {"Sealed by": explain(error)})
            return
        self._album.visible = bool(taken)
        self._pictures.show(taken)
        names = self._console.live.summary.names
        self._proof.show(shown, _seal_facts(seal, devices, names))

    def _draw_report(self, report: Json | None, problem: str) -> None:
        by_people = report is not None and "auditor" in report
        widgets.retitle(self._report_head, "Auditor's verdict" if by_people else _ORACLES_REPORT)
        if report is None:
            widgets.empty(problem)
        elif by_people and self.shown is not None:
            # A person's word: the oracle measured none of it, and it must not read as if it had.
            verdict = self._verdict
            widgets.Text("p", f"{verdict[:1].upper()}{verdict[1:]}", "wrap")
            widgets.empty("A person judged this proof; the oracle's checks did not decide it.")
        else:
            draw_report(report)

    def _draw_proof(self, attempt: Attempt | None, sealed: dict[str, str]) -> None:
        if attempt is None:
            widgets.empty("No proof was submitted yet.")
            return
        with widgets.facts():
            widgets.fact("Attempt", str(attempt.number))
            widgets.fact("SHA-256", lambda: widgets.hash_text(attempt.proof_sha256 or ""))
            for name, value in sealed.items():
                widgets.fact(name, partial(widgets.hash_text, value) if value.startswith("0x") else value)
        ui.button("Download", icon="download").props(
            f'outline dense href="/files/proof/{self._task_id}?attempt={attempt.number}" '
            'aria-label="Download the proof"'
        ).style("align-self: start")


def _seal_facts(seal: Seal, devices: list[OwnedDevice], names: dict[str, str]) -> dict[str, str]:
    signer = next((one for one in devices if one.address == seal.signer), None)
    owner = names.get(seal.signer or "")
    whose, revoked = "unknown" if owner is None else f"none: {owner}'s own key", ""
    if signer is not None:
        whose = f"{signer.role} {signer.name} of {signer.owner_name or signer.owner}"
        revoked = f" (revoked: {signer.revoked_because})" if signer.revoked else ""
    return {
        "Sealed by": seal.signer or "nobody",
        "Device": whose + revoked,
        "Recording": f"{number(Decimal(seal.size_bytes) / 10**6)} MB, {seal.messages:,} messages, "
        f"{seal.seals:,} seals, all in order",
    }
