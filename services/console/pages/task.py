"""One task: how it went, what it cost, what proves it."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

from rodeo.errors import RodeoError
from rodeo.evidence import open_proof
from rodeo.messages import Task
from services.console.lab_map import LabMap
from services.console.pages.frame import Console, act, ask, back_link, fail, follow_async, frame, user
from services.console.pages.widgets import (
    Section,
    Text,
    badge,
    card,
    confirm,
    empty,
    fact,
    facts,
    hash_text,
    notice,
    table,
)
from services.console.replay import track
from services.console.roles import Role
from services.console.words import explain, iec, kind, moment, parameter, party, span

Json = dict[str, Any]


def register(console: Console) -> None:
    @ui.page("/tasks/{task_id}")
    def task_page(task_id: int) -> None:
        with frame(console, f"Task {task_id}", "/tasks", heading=False):
            TaskPage(console, task_id)


class TaskPage:
    def __init__(self, console: Console, task_id: int) -> None:
        self._console = console
        self._task_id = task_id
        self._report_of: str | None = None
        back_link("Tasks", "/tasks")
        self._head = Section(self._draw_head).live()
        self._problem = Section(lambda text: notice(text, bad=True) if text else None).live()
        with card("Progress"):
            self._progress = Section(_draw_progress)
        with ui.element("div").classes("grid"):
            with ui.element("div").classes("stack span-7"), card("Where") as head:
                self._map = LabMap(console.lab, "Map of the lab: where the task is")
                with head:
                    self._replay = ui.button(
                        "Replay the recording", icon="replay", on_click=self._load_replay
                    )
                    self._replay.props("flat dense")
                    self._replay.visible = False
            with ui.element("div").classes("stack span-5"):
                with card("Agreement"):
                    self._agreement = Section(_draw_agreement)
                with card("Proof"):
                    self._proof = Section(_draw_proof)
                with card("Transactions"):
                    self._transactions = Section(_draw_transactions)
        with card("Oracle's report"):
            self._report = Section(_draw_report)
        follow_async(console, "organization", self._load)

    async def _load(self) -> None:
        reads = self._console.reads
        try:
            task = await ask(reads.task, self._task_id)
        except RodeoError as error:
            self._problem.show(
                f"There is no task {self._task_id}." if error.code == "unknown_task" else explain(error)
            )
            return
        self._problem.show("")
        self._head.show(task)
        self._progress.show(task)
        self._agreement.show(task)
        self._proof.show(task)
        self._replay.visible = task.proof_uri is not None
        place = task.params.get("x_m"), task.params.get("y_m")
        if all(isinstance(value, int | float) for value in place):
            self._map.mark_place(place)  # type: ignore[arg-type]
        await self._load_report(task)
        try:
            answer = await ask(reads.state, "transactions", task_id=self._task_id)
            self._transactions.show(answer["transactions"], "")
        except RodeoError as error:
            self._transactions.show([], explain(error))

    async def _load_report(self, task: Task) -> None:
        if task.report_sha256 is None:
            self._report.show(None, "The oracle has not judged a proof of this task yet.")
            return
        try:
            self._report.show(await ask(self._console.reads.report, task), "")
        except RodeoError as error:
            self._report.show(None, explain(error))

    def _draw_head(self, task: Task) -> None:
        with ui.element("div").classes("page-head"):
            Text("h1", f"Task {task.id} · {kind(task.kind)}")
            badge(task.state)
            ui.element("span").classes("grow")
            if user().has(Role.OPERATOR):
                if task.state == "open":
                    cancel = ui.button("Cancel", on_click=lambda: self._cancel(task))
                    cancel.props("outline color=negative")
                ui.button("Post again").props(f'outline href="/tasks/new?like={task.id}"')
        if task.description:
            Text("p", task.description, "soft wrap")

    async def _cancel(self, task: Task) -> None:
        lines = [
            ("Task", f"{task.id} · {kind(task.kind)}"),
            ("Back to the organization", iec(task.reward_iec)),
        ]
        if await confirm("Cancel this task?", lines, "Cancel the task", danger=True):
            await act(self._console, "cancel_task", {"task_id": task.id}, f"Task {task.id} is cancelled")

    async def _load_replay(self) -> None:
        self._replay.props("loading")
        try:
            shown = await ask(_read_recording, self._console, self._task_id)
        except RodeoError as error:
            fail(error)
            return
        finally:
            self._replay.props(remove="loading")
        self._replay.visible = False
        self._map.replay(shown["track"])
        self._proof.show(await ask(self._console.reads.task, self._task_id), shown)


def _read_recording(console: Console, task_id: int) -> Json:
    """The recording as the map replays it, and who sealed it. Raises UnknownFile, EvidenceError."""
    task = console.reads.task(task_id)
    with tempfile.TemporaryDirectory(prefix="rodeo-replay-") as folder:
        proof = open_proof(console.reads.proof(task, Path(folder)))
        devices = {one["address"]: one for one in console.reads.state("devices")["devices"]}
        signer = devices.get(proof.signer)
        return {
            "track": track(proof, console.site),
            "signer": proof.signer,
            "device": f"{signer['role']} of {party(signer['owner_name'], signer['owner'])}"
            if signer
            else "unknown",
            "revoked": bool(signer and signer["revoked"]),
            "size_bytes": proof.size_bytes,
            "messages": proof.messages,
            "seals": proof.seals,
        }


def _draw_progress(task: Task) -> None:
    """The state machine with its times, as far as it got."""
    over = task.state in ("settled", "failed", "cancelled")
    steps: list[tuple[str, float | None, str]] = [
        ("Posted", task.registered, "done"),
        ("Assigned", task.assigned, "done" if task.assigned else "now" if task.state == "open" else ""),
        (
            "Proof submitted",
            task.proof_submitted,
            "done" if task.proof_submitted else "now" if task.state == "assigned" else "",
        ),
        (
            f"Verdict: {task.verdict}" if task.verdict else "Verdict",
            None,
            {"accepted": "done", "rejected": "bad", "expired": "bad"}.get(
                task.verdict or "", "now" if task.state == "submitted" else ""
            ),
        ),
        (
            {"failed": "Failed, refunded", "cancelled": "Cancelled, refunded"}.get(task.state, "Paid"),
            task.settled,
            {"settled": "done", "failed": "bad", "cancelled": "bad"}.get(task.state, ""),
        ),
    ]
    with ui.element("ol").classes("steps"):
        before: float | None = None
        for title, time_s, state in steps:
            with ui.element("li").classes(state) as item:
                if state == "now":
                    item.props('aria-current="step"')
                Text("strong", title)
                if time_s is not None:
                    Text("div", moment(time_s))
                    if before is not None:
                        Text("div", f"after {span(time_s - before)}")
                    before = time_s
    if task.attempt:
        Text(
            "p", f"Attempt {task.attempt} of {task.max_attempts}" + ("" if over else _deadline(task)), "soft"
        )
    if task.reason and task.verdict != "accepted":
        notice(f"Last verdict: {task.reason}", bad=True)


def _deadline(task: Task) -> str:
    if task.state == "assigned" and task.execution_deadline:
        return f"; the proof is due by {moment(task.execution_deadline)}"
    if task.state == "submitted" and task.verdict_deadline:
        return f"; the verdict is due by {moment(task.verdict_deadline)}"
    return ""


def _draw_agreement(task: Task) -> None:
    live = task.state in ("open", "assigned", "submitted")
    with facts():
        fact("Creator", party(task.creator_name, task.creator))
        fact("Executor", party(task.executor_name, task.executor) if task.executor else "nobody yet")
        fact("Reward", iec(task.reward_iec))
        fact("Agreed price", iec(task.price_iec))
        fact("In escrow", iec(task.reward_iec if live else 0))
        fact("Paid", iec(task.paid_iec))
        if task.state == "settled":
            fact("Returned", iec(task.reward_iec - task.paid_iec))
        for name, value in task.params.items():
            fact(parameter(name), str(value)[:200], "wrap")


def _draw_proof(task: Task, opened: Json | None = None) -> None:
    if task.proof_sha256 is None or task.proof_uri is None:
        empty("No proof was submitted for the running attempt.")
        return
    with facts():
        fact("SHA-256", lambda: hash_text(task.proof_sha256 or ""))
        if opened is not None:
            fact("Sealed by", lambda: hash_text(opened["signer"]))
            fact("Device", opened["device"] + (" (revoked)" if opened["revoked"] else ""))
            fact("Recording", f"{opened['size_bytes'] / 1e6:.1f} MB, {opened['messages']:,} messages, "
                              f"{opened['seals']:,} seals")  # fmt: skip
        else:
            fact("Sealed by", "shown with the replay, which checks every seal")
    ui.button("Download", icon="download").props(
        f'outline dense href="/files/proof/{task.id}" aria-label="Download the proof"'
    ).style("align-self: start")


def _draw_report(report: Json | None, problem: str) -> None:
    if report is None:
        empty(problem)
        return
    with ui.element("div").classes("line"):
        badge("accepted" if report.get("accepted") else "rejected")
        Text("span", str(report.get("reason", ""))[:500], "wrap")
    checks = [check for check in report.get("checks", []) if isinstance(check, dict)]
    words = {True: ("passed", "good"), False: ("failed", "bad"), None: ("skipped", "")}
    table(
        "Checks of the oracle",
        [
            ("Check", "plain"),
            ("Result", ""),
            ("Measured", "number"),
            ("Limit", "number"),
            ("About", "wide-only wrap"),
        ],
        [
            (
                str(check.get("name", "")).replace("_", " "),
                partial(badge, *words.get(check.get("passed"), words[None])),
                _measured(check.get("measured"), check.get("unit")),
                _measured(check.get("limit"), check.get("unit")),
                str(check.get("detail") or check.get("source") or "")[:300],
            )
            for check in checks
        ],
    )


def _measured(value: Any, unit: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    text = text if len(text) <= 24 else f"{text[:12]}…{text[-8:]}"
    return f"{text} {unit}" if unit else text


def _draw_transactions(transactions: list[Json], problem: str) -> None:
    if problem:
        notice(problem)
    elif not transactions:
        empty("No transactions known.")
    else:
        table(
            "Transactions of this task",
            [("What", ""), ("Gas", "number"), ("Hash", "")],
            [
                (
                    str(one.get("command") or one.get("event") or one.get("name") or ""),
                    f"{int(one['gas_used']):,}" if one.get("gas_used") is not None else "–",
                    partial(hash_text, str(one.get("tx_hash", ""))),
                )
                for one in transactions
            ],
        )
