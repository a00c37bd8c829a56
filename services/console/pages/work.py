"""My work: tasks of a person who does them, and proofs that wait for an auditor."""

from __future__ import annotations

import base64
from decimal import Decimal
from functools import partial
from typing import Any

from nicegui import ui
from nicegui.events import UploadEventArguments

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.display.formatting import count, explain, iec, kind
from rodeo.errors import RodeoError
from rodeo.judging.verdicts import FAULTS, MEANINGS, WORDS, is_peoples_verdict, standing_words, verdict_words
from rodeo.person import pace
from rodeo.person.pace import running_out_s
from rodeo.person.photo_code import photo_code
from rodeo.person.statement import MAX_PHOTO_BYTES, MAX_PHOTOS, Statement, check_photo, photo_format
from services.console.pages import frame, widgets
from services.console.pages.frame import Console

SHOWN = 20


def desks(console: Console) -> None:
    person = frame.user()
    if warning := pace.warning(console.site):
        widgets.notice(warning)
    frame.require("work or judge here", Role.EXECUTOR, Role.AUDITOR)
    if person.has(Role.EXECUTOR):
        if person.participant is None:
            widgets.notice("Your account has no participant. An administrator can set one.", bad=True)
        else:
            ExecutorDesk(console, person.participant)
    if person.has(Role.AUDITOR):
        AuditorDesk(console)


class ExecutorDesk:
    """What is assigned to a participant without a body, and what became of the rest."""

    def __init__(self, console: Console, participant: str) -> None:
        self._console = console
        self._participant = participant
        frame.follow_async(console, "events", self._load)
        with ui.element("div").classes("grid tiles"):
            self._balance, self._todo, self._waiting, self._paid = (
                widgets.tile(name, "–")
                for name in ("my balance", "to do", "waiting for a verdict", "paid tasks")
            )
        with ui.element("div").classes("grid"):
            with ui.element("div").classes("stack span-7"), widgets.card("To do"):
                self._assigned = widgets.Section(self._draw_assigned).waiting().live()
            with ui.element("div").classes("stack span-5"), widgets.card("Handed in"):
                self._ended = widgets.Section(_draw_ended).waiting().live()

    async def _load(self) -> None:
        mine = partial(self._console.queries.tasks, executor=self._participant)
        todo, total = await frame.ask(mine, SHOWN, state="assigned", order="oldest")
        ended, _ = await frame.ask(mine, SHOWN, state="submitted,ruled,settled,failed")
        _, waiting = await frame.ask(mine, 1, state="submitted,ruled")
        _, paid = await frame.ask(mine, 1, state="settled")
        wallet = await frame.ask(self._console.queries.ask, queries.WALLET, account=self._participant)
        self._balance.set_text(iec(wallet.balance_iec))
        for shown, number in ((self._todo, total), (self._waiting, waiting), (self._paid, paid)):
            shown.set_text(f"{number:,}")
        self._assigned.show(todo)
        self._ended.show(ended)

    def _draw_assigned(self, tasks: list[Task]) -> None:
        def draw(task: Task) -> None:
            with ui.element("span").classes("line tight"):
                request, done = {"task_id": task.id}, f"Task {task.id} is yours to do"
                accept = partial(frame.act, self._console, "accept_work", request, done)
                ui.button("Accept", on_click=widgets.on_page(accept)).props(
                    f'outline dense aria-label="Accept task {task.id}"'
                )
                ui.button("Hand in", on_click=partial(self._hand_in, task)).props(
                    f'unelevated dense aria-label="Hand in task {task.id}"'
                )
            due = f" · due by {frame.when(task.execution_deadline)}" if task.execution_deadline else ""
            widgets.Text(
                "span", f"{task.description or 'no description'} · pays {iec(task.price_iec)}{due}", "soft"
            )
            if task.execution_deadline:
                frame.time_left(self._console, task.execution_deadline)
            if task.nonce:
                widgets.Text("span", f"Show the code {photo_code(task.nonce)} in a photo", "soft")

        widgets.task_list(
            tasks, draw, "Nothing is assigned to you. Offer a service, and tasks of its kind come here."
        )

    @widgets.on_page
    async def _hand_in(self, task: Task) -> None:
        """Ask for note and photos; the form stays until they are handed in or it is closed."""
        photos: list[bytes] = []

        async def take(event: UploadEventArguments) -> None:
            data = await event.file.read()
            if await frame.asked(check_photo, data) is None:
                return
            photos.append(data)
            added.set_text(f"{count(len(photos), 'photo')} added")

        async def review() -> None:
            if not await drop.all_taken(go_on):
                return
            text = (note.value or "").strip()
            if not text:
                ui.notify("Say in a sentence what you did", type="warning")
                return
            lines = [("Note", text), ("Photos", str(len(photos))), ("After that", "it cannot be changed")]
            if not await widgets.confirm(f"Hand in task {task.id}?", lines, "Seal and hand in"):
                return
            request = {
                "task_id": task.id,
                "note": text,
                "photos": [base64.b64encode(photo).decode() for photo in photos],
            }
            done = f"Task {task.id} is handed in"
            if await frame.act(self._console, "submit_work", request, done) is not None:
                dialog.submit(True)

        with widgets.modal(f"Hand in task {task.id}") as dialog:
            dialog.props("no-backdrop-dismiss")
            note = ui.textarea("What did you do?").props("outlined dense autofocus maxlength=4000")
            note.style("width: 100%")
            drop = widgets.FileDrop(
                "or drop photos here (JPEG or PNG)",
                "image/jpeg,image/png",
                take,
                multiple=True,
                max_file_size=MAX_PHOTO_BYTES,
                max_files=MAX_PHOTOS,
                on_rejected=lambda: ui.notify(
                    f"At most {MAX_PHOTOS} JPEG or PNG pictures of 8 MB", type="warning"
                ),
            )
            added = widgets.Text("p", "No photo yet", "soft").props('aria-live="polite"')
            go_on = widgets.dialog_buttons(dialog, "Review", review)
        await dialog


def _draw_ended(tasks: list[Task]) -> None:
    def draw(task: Task) -> None:
        verdict = task.verdict or ""
        widgets.badge(WORDS.get(verdict, verdict) or task.state)
        by_people = is_peoples_verdict(task)
        said = verdict_words(verdict, task.reason, None, by_people, task.fault)
        if task.state == "settled":
            said = f"paid {iec(task.paid_iec)} on {frame.when(task.settled)} · {said}"
        elif task.standing is not None:
            said = standing_words(task, iec(task.standing.amount_iec), frame.when(task.standing.until))
        widgets.Text("span", said or "waiting for the ruling", "soft")

    widgets.task_list(tasks, draw, "You have submitted nothing yet.")


def _due(task: Task) -> str:
    if task.standing is not None:
        return f" · {standing_words(task, iec(task.standing.amount_iec), frame.when(task.standing.until))}"
    return f" · ruling due by {frame.when(task.verdict_deadline)}" if task.verdict_deadline else ""


class AuditorDesk:
    """Proofs that wait for an auditor: of kinds that auditors judge, passed on by another judge, or of a
    judge that was removed."""

    def __init__(self, console: Console) -> None:
        self._console = console
        frame.follow_async(console, "events", self._load)
        with widgets.card("To judge"):
            self._waiting = widgets.Section(self._draw).waiting().live()

    async def _load(self) -> None:
        tasks = self._console.queries.tasks
        live, _ = await frame.ask(tasks, queries.MAX_PAGE, state="submitted,ruled", order="oldest")
        waiting = [one for one in live if one.judge == "auditor" or one.passed_on or one.judge_removed]
        self._waiting.show(waiting[:SHOWN])

    def _draw(self, tasks: list[Task]) -> None:
        def draw(task: Task) -> None:
            ui.button("Open", on_click=partial(self._open, task)).props(
                f'unelevated dense aria-label="Judge task {task.id}"'
            )
            who = f"{task.executor_name or task.executor} for {iec(task.price_iec)}"
            widgets.Text("span", f"{who}{_due(task)}", "soft")
            if (ends_s := running_out_s(task)) is not None:
                frame.time_left(self._console, ends_s)

        widgets.task_list(tasks, draw, "No proof waits for an auditor.")

    @widgets.on_page
    async def _open(self, task: Task) -> None:
        """Show the evidence and ask for a verdict; the form stays until it is given or it is closed."""
        statement, known = await self._evidence(task)

        async def answer() -> None:
            if (request := await _confirmed(task, *(one.value for one in inputs))) is None:
                return
            if await frame.act(self._console, "judge", request, f"Task {task.id} is judged") is not None:
                dialog.submit(True)

        with widgets.modal(f"Judge task {task.id}", "broad") as dialog:
            dialog.props("no-backdrop-dismiss")
            widgets.Text("p", task.description or kind(task.kind), "wrap")
            if task.standing is not None:
                stands = _due(task).removeprefix(" · ")
                widgets.notice(f"{stands[:1].upper()}{stands[1:]}.")
            if self._console.kinds.by_people(task.kind):
                _draw_evidence(statement, known)
            else:
                await self._draw_recording(task)
            ruling = ui.select(MEANINGS, value="accepted", label="Ruling").props("outlined dense")
            fault = ui.select({**FAULTS}, value="nobody", label="Whose doing it is").props("outlined dense")
            amount = ui.input("Pay (IEC)", value=f"{task.price_iec or 0:f}").props("outlined dense")
            reason = ui.input("Why?").props("outlined dense maxlength=500")
            inputs = (ruling, fault, amount, reason)
            for one in inputs:
                one.style("width: 100%")
            fault.bind_visibility_from(ruling, "value", value="void")
            amount.bind_visibility_from(ruling, "value", value="accepted")
            widgets.dialog_buttons(dialog, "Rule", answer)
        await dialog

    async def _evidence(self, task: Task) -> tuple[Statement | None, list[str]]:
        """A person's statement, and what is known about the proof."""
        if not self._console.kinds.by_people(task.kind):
            return None, []
        if (statement := await frame.asked(self._console.queries.statement, task)) is None:
            return None, []
        try:
            return statement, (await frame.ask(self._console.queries.review, task)).lines()
        except RodeoError as error:
            return statement, [f"Cannot load the proof's details: {explain(error)}"]

    async def _draw_recording(self, task: Task) -> None:
        """What a robot recorded: its pictures here, the rest on the task's page."""
        try:
            widgets.pictures(await frame.ask(self._console.queries.pictures, task))
        except RodeoError as error:
            widgets.notice(f"Cannot show the recording's pictures: {explain(error)}")
        widgets.Link("The replay of the recording, and the oracle's report", f"/tasks/{task.id}")


def _draw_evidence(statement: Statement | None, known: list[str]) -> None:
    if statement is None:
        widgets.notice("The proof holds no statement to show.")
    else:
        widgets.Text("p", f"“{statement.note}”", "wrap")
        for number, photo in enumerate(statement.photos, start=1):
            source = f"data:image/{photo_format(photo)};base64,{base64.b64encode(photo).decode()}"
            widgets.picture(source, f"Photo {number} of the work")
    with ui.element("ul").classes("list").props('aria-label="Known facts about the proof"'):
        for line in known:
            widgets.Text("li", line, "soft wrap")


async def _confirmed(
    task: Task, said: str, fault: Any, amount: str | None, reason: str | None
) -> dict[str, object] | None:
    """The request to judge a task, once the auditor has confirmed it."""
    accepted = said == "accepted"
    text, paid = (reason or "").strip(), (amount or "").strip()
    if not text:
        ui.notify("Give a reason: the executor reads it", type="warning")
        return None
    tenth = iec((task.price_iec or Decimal(0)) / 10)  # IMPOSSIBLE_SHARE of the contract
    lines = [
        ("Task", f"{task.id} · {kind(task.kind)}"),
        ("Ruling", MEANINGS[said]),
        ("Reason", text),
        ("Agreed price", iec(task.price_iec)),
        ("Paid to the executor", f"{paid} IEC" if accepted else tenth if said == "impossible" else iec(0)),
    ]
    if said == "void":
        lines.insert(2, ("Whose doing", FAULTS[fault]))
    if not await widgets.confirm("Rule on this work?", lines, "Rule", danger=not accepted):
        return None
    request: dict[str, object] = {"task_id": task.id, "ruling": said, "reason": text}
    request |= {"fault": fault} if said == "void" else {}
    return request | ({"amount_iec": paid} if accepted and task.price_iec else {})
