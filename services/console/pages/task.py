"""One task: how it went, what it cost, what proves it."""

from __future__ import annotations

import re
from collections.abc import Callable
from decimal import Decimal
from functools import partial

from nicegui import ui

from rodeo.access.accounts import workers
from rodeo.access.roles import Role
from rodeo.bus.messages import LIVE_STATES, Task
from rodeo.bus.queries import SERVICES, TRANSACTIONS, Transaction
from rodeo.dao import cancellation
from rodeo.display.formatting import (
    explain,
    iec,
    kind,
    number,
    party,
    passed_in_words,
    phrase,
    short,
    span,
    tries_in_words,
    worth,
)
from rodeo.display.story import Step
from rodeo.errors import RodeoError
from rodeo.judging.verdicts import (
    MEANINGS,
    NO_REPORT,
    WORDS,
    is_peoples_verdict,
    judge_of,
    judge_words,
    standing_words,
    verdict_words,
)
from rodeo.kinds import PHOTO, fields
from rodeo.person.pace import running_out_s
from rodeo.person.photo_code import photo_code
from services.console.attempts import Attempt, attempts, ended_s
from services.console.lab_map import LabViews
from services.console.pages import dispute, frame, widgets
from services.console.pages.forms import ask_command
from services.console.pages.frame import Console
from services.console.pages.parameters import label
from services.console.pages.replay import track_of
from services.console.pages.task_evidence import TaskEvidence
from services.console.posting import fitting

_TOKEN_EVENTS = ("Transfer", "Approval")
"""Every transaction of a task has some; the treasury explains them."""


def register(console: Console) -> None:
    @frame.at(console, "/tasks/{task_id}")
    def task_page(task_id: int) -> None:
        with frame.page(console, f"Task {task_id}", "/tasks", heading=False):
            TaskPage(console, task_id)


class TaskPage:
    def __init__(self, console: Console, task_id: int) -> None:
        self._console = console
        self._task_id = task_id
        self._chosen: int | None = None
        """The attempt whose proof and report are shown; None for the newest that has one."""
        self._live = False
        widgets.Link("← Tasks", "/tasks", "soft")
        self._head = widgets.Section(self._draw_head).live()
        self._refresh = frame.follow_async(console, "events", self._load)
        self._parts = ui.element("div").classes("stack")
        with self._parts:
            with widgets.card("Progress"):
                self._progress = widgets.Section(partial(_draw_progress, console)).waiting()
            with widgets.card("Attempts"):
                self._tries = widgets.Section(self._draw_attempts).waiting()
            with widgets.card("Where") as head:
                self._lab = LabViews(console.lab, "where the task is")
                with head:
                    self._replay = ui.button("Replay the recording", on_click=self._load_replay)
                    self._replay.props("flat dense icon=replay")
                    self._replay.visible = False
            with ui.element("div").classes("grid"):
                with widgets.card("Agreement", "span-6"):
                    self._agreement = widgets.Section(partial(_draw_agreement, console)).waiting()
                evidence = self._evidence = TaskEvidence(console, task_id)
            evidence.report_card()
            with widgets.card("Transactions"):
                self._transactions = widgets.Section(_draw_transactions).waiting()
        frame.follow(console, "map", self._show_map)

    def _show_map(self) -> None:
        """Robots are shown while somebody works on the task."""
        if self._live:
            self._lab.map.show(self._console.live.map)

    async def _load(self) -> None:
        queries = self._console.queries
        try:
            task = await frame.ask(queries.task, self._task_id)
        except RodeoError as error:
            if error.code != "unknown_task":
                raise
            self._head.show(None)
            self._parts.visible = False
            return
        events = await frame.ask(queries.history, self._task_id)
        self._parts.visible = True
        made = attempts(events)
        proven = [one for one in made if one.proof_sha256 is not None]
        shown = next((one for one in reversed(proven) if self._chosen in (None, one.number)), None)
        self._live = task.state in LIVE_STATES
        self._head.show(task)
        self._progress.show(task, ended_s(events))
        names = self._console.live.summary.names
        try:
            transactions = (await frame.ask(queries.ask, TRANSACTIONS, task_id=self._task_id)).transactions
            self._transactions.show(transactions, "")
        except RodeoError as error:
            transactions = []
            self._transactions.show([], explain(error))
        people = workers(self._console.site)
        verdicts = {one.number: _verdict(task.judge == "auditor", one, transactions, people) for one in made}
        story = await dispute.story_of(self._console, events)
        number = None if shown is None else shown.number
        self._tries.show(made, names, number, verdicts, story)
        self._agreement.show(task)
        self._show_map()
        place = task.params.get("x_m"), task.params.get("y_m")
        if all(isinstance(value, int | float) for value in place):
            self._lab.map.mark_place(place)  # type: ignore[arg-type]
        self._replay.visible = shown is not None
        await self._evidence.load(shown, "" if number is None else verdicts[number])

    def _draw_attempts(
        self,
        made: list[Attempt],
        names: dict[str, str],
        shown: int | None,
        verdicts: dict[int, str],
        story: list[Step] | str,
    ) -> None:
        columns: widgets.Columns[Attempt] = [
            widgets.Column("Attempt", lambda one: str(one.number)),
            widgets.Column("Executor", lambda one: party(names.get(one.executor), one.executor)),
            widgets.Column("Assigned", lambda one: frame.when(one.assigned_s), "plain wide-only"),
            widgets.Column("Proof submitted", lambda one: frame.when(one.submitted_s), "plain wide-only"),
            widgets.Column("Outcome", lambda one: _draw_outcome(one, verdicts[one.number]), "wrap"),
            widgets.Column("", lambda one: self._choice(one, shown == one.number), "number"),
        ]
        widgets.table("Attempts at this task", columns, made, "Nobody has accepted it yet.")
        proven = [f"{self._task_id}.{one.number}" for one in made if one.proof_sha256 is not None]
        if len(proven) > 1:
            widgets.Link("Compare the last two", f"/replay?left={proven[-2]}&right={proven[-1]}")
        dispute.draw_story(story)

    def _choice(self, attempt: Attempt, is_shown: bool) -> None:
        if attempt.proof_sha256 is None:
            return
        if is_shown:
            widgets.Text("span", "shown below", "soft wide-only")
            return
        ui.button("Show", on_click=partial(self._choose, attempt.number)).props(
            f'flat dense aria-label="Show proof and report of attempt {attempt.number}"'
        )

    def _choose(self, number: int) -> None:
        self._chosen = number
        self._lab.replay.show(None)
        self._refresh()

    def _draw_head(self, task: Task | None) -> None:
        """None when there is no such task."""
        if task is None:
            frame.page_head(f"Task {self._task_id}")
            widgets.notice(f"There is no task {self._task_id}. Look for its number under Tasks.", bad=True)
            return
        with frame.page_head(f"Task {task.id} · {kind(task.kind)}", state=task.state):
            if frame.user().has(Role.OPERATOR):
                if task.state == "open":
                    match = ui.button("Match with a service", on_click=lambda: self._match(task))
                    match.props("outline")
                    cancel = ui.button("Cancel", on_click=lambda: self._cancel(task))
                    cancel.props("outline color=negative")
                ui.button("Post again").props(f'outline href="/tasks/new?like={task.id}"')
            dispute.draw_button(self._console, task)
            if self._can_be_concluded(task) and frame.may("conclude"):
                request, done = {"task_id": task.id}, f"Task {task.id} is concluded"
                conclude = partial(frame.act, self._console, "conclude", request, done)
                ui.button("Conclude", on_click=widgets.on_page(conclude)).props("outline")
        if task.description:
            widgets.Text("p", task.description, "soft wrap")

    @widgets.on_page
    async def _cancel(self, task: Task) -> None:
        lines = [
            ("Task", f"{task.id} · {kind(task.kind)}"),
            ("Back to the organization", iec(task.reward_iec)),
        ]
        if await widgets.confirm("Cancel this task?", lines, "Cancel the task", danger=True):
            request = cancellation(task.id)
            await frame.act(self._console, request.declared.name, request, f"Task {task.id} is cancelled")

    @widgets.on_page
    async def _match(self, task: Task) -> None:
        """A match considers a few services only, so that somebody may have to name one."""
        answer = await frame.asked(self._console.queries.ask, SERVICES, kind=task.kind)
        if answer is not None:
            choices = {"": "as the policy chooses"} | fitting(task, answer.services)
            known, offered = {"task_id": task.id}, {"service_id": choices}
            await ask_command(self._console, "match_task", self._refresh, known, offered=offered)

    def _can_be_concluded(self, task: Task) -> bool:
        """Whether the time of the ruling is over, or that to rule; unknown while nobody publishes the
        time."""
        pace = self._console.live.heartbeats.pace
        ends_s = running_out_s(task) if task.state in ("submitted", "ruled") else None
        return pace is not None and ends_s is not None and pace.now_s > ends_s

    async def _load_replay(self) -> None:
        if self._evidence.shown is None:
            return
        self._replay.props("loading")
        recording = await frame.asked(track_of, self._console, self._evidence.shown)
        self._replay.props(remove="loading")
        if recording is not None:
            self._replay.visible = False
            self._lab.replay.show(recording)


def _verdict(by_kind: bool, attempt: Attempt, transactions: list[Transaction], people: list[str]) -> str:
    """The verdict on the attempt in words, and by whom; empty while there is none.

    `by_kind`: auditors judge its kind of work.
    """
    said = attempt.verdict or attempt.standing
    if said is None:
        return ""
    judge = judge_of(transactions, attempt.verdict_tx) if attempt.verdict_tx else None
    by_people = (by_kind or attempt.passed_on or judge in people) and (said != "void" or judge is not None)
    if attempt.passed_on and attempt.standing == "void":
        return f"passed on to the auditors by {judge_words(None, False)}: {attempt.reason or NO_REPORT}"
    stands = "stands: " if attempt.standing else ""
    return stands + verdict_words(said, attempt.reason, judge, by_people, attempt.fault)


def _draw_outcome(attempt: Attempt, verdict: str) -> None:
    word = WORDS.get(attempt.verdict or "", attempt.verdict) or ("ruled" if attempt.standing else None)
    widgets.badge(word or ("submitted" if attempt.submitted_s else "assigned"))
    if attempt.paid_iec is not None:
        widgets.Text("div", f"paid {iec(attempt.paid_iec)}", "soft")
    if not attempt.counts:
        widgets.Text("div", "does not count as an attempt", "soft")
    if verdict:
        widgets.Text("div", verdict[:1].upper() + verdict[1:], "soft wrap")
    if (said := attempt.verdict) in MEANINGS:
        widgets.Text("div", MEANINGS[said].partition(": ")[2].capitalize() + ".", "soft wrap")


_ENDS = {
    "settled": ("Paid", "done"),
    "failed": ("Failed, refunded", "bad"),
    "cancelled": ("Cancelled, refunded", "bad"),
}
"""State -> the last step of the progress, and how it looks."""


def _draw_progress(console: Console, task: Task, ended: float | None) -> None:
    """The state machine with its times, as far as it got."""
    verdict = task.verdict or ""
    judged = "done" if verdict in ("accepted", "impossible") else "bad" if verdict else ""
    paid, how = _ENDS.get(task.state, ("Paid", ""))
    steps: list[tuple[str, float | None, str]] = [
        ("Posted", task.registered, "done"),
        ("Assigned", task.assigned, "done" if task.assigned else "now" if task.state == "open" else ""),
        (
            "Proof submitted",
            task.proof_submitted,
            "done" if task.proof_submitted else "now" if task.state == "assigned" else "",
        ),
        (_verdict_step(task), None, judged or ("now" if task.state in ("submitted", "ruled") else "")),
        (paid, ended, how),
    ]
    with ui.element("ol").classes("steps"):
        before: float | None = None
        for title, time_s, state in steps:
            with ui.element("li").classes(state) as item:
                if state == "now":
                    item.props('aria-current="step"')
                widgets.Text("strong", title)
                if time_s is not None:
                    widgets.Text("div", frame.when(time_s))
                    if before is not None:
                        widgets.Text("div", f"after {span(time_s - before)}")
                    before = time_s
    if task.attempt:
        widgets.Text(
            "p",
            f"Attempt {tries_in_words(task)}" + (_deadline(task) if task.state in LIVE_STATES else ""),
            "soft",
        )
    ends_s = running_out_s(task)
    if ends_s is not None:
        frame.time_left(console, ends_s)


def _verdict_step(task: Task) -> str:
    if task.standing is not None:
        stands = "Challenged: judges decide" if _is_challenged(task) else "Ruling stands"
        return "An auditor decides" if task.passed_on else stands
    if not task.verdict:
        return "Verdict"
    by_people = is_peoples_verdict(task)
    word = WORDS.get(task.verdict, task.verdict)
    return f"Verdict: {word}" + (" by an auditor" if by_people else "")


def _is_challenged(task: Task) -> bool:
    return task.dispute is not None and task.dispute.challenger is not None and not task.dispute.settled


def _deadline(task: Task) -> str:
    if task.state == "assigned" and not task.accepted:
        return f"; the executor has until {frame.when(task.grace_ends_s)} to accept it"
    if task.state == "assigned" and task.execution_deadline:
        return f"; the proof is due by {frame.when(task.execution_deadline)}"
    if task.state == "submitted" and task.verdict_deadline:
        return f"; the ruling is due by {frame.when(task.verdict_deadline)}"
    if task.standing is not None:
        stands = "judges decide" if _is_challenged(task) else "the ruling stands"
        stands = "auditors may rule" if task.passed_on else stands
        return f"; {stands} until {frame.when(task.standing.until)}"
    return ""


def _draw_agreement(console: Console, task: Task) -> None:
    kinds, site = console.kinds, console.site
    live = task.state in LIVE_STATES
    photos = fields(kinds[task.kind], "photo") if task.kind in kinds else []
    with widgets.facts():
        widgets.fact("Creator", party(task.creator_name, task.creator))
        widgets.fact("Executor", party(task.executor_name, task.executor) if task.executor else "nobody yet")
        if task.standing is not None:
            stands = standing_words(task, iec(task.standing.amount_iec), frame.when(task.standing.until))
            widgets.fact("Stands", stands, "wrap")
        if task.passed:
            widgets.fact("Not offered again to", passed_in_words(task), "wrap")
        if task.requested_service_id is not None:
            widgets.fact("Only service", str(task.requested_service_id))
        if task.requested_provider is not None:
            widgets.fact("Only provider", party(task.requested_provider_name, task.requested_provider))
        if task.nonce and kinds.by_people(task.kind):
            widgets.fact("Code to show in a photo", photo_code(task.nonce))
        widgets.fact("Reward", worth(task.reward_iec, site))
        widgets.fact("Agreed price", worth(task.price_iec, site))
        widgets.fact("In escrow", worth(task.reward_iec if live else 0, site))
        widgets.fact("Paid", worth(task.paid_iec, site))
        if task.refunded_iec:
            widgets.fact("Returned", worth(task.refunded_iec, site))
        known = {} if (chosen := kinds.get(task.kind)) is None else chosen.schema.get("properties", {})
        for name in [*filter(task.params.__contains__, known), *sorted(task.params.keys() - known.keys())]:
            shown: str | Callable[[], object] = (value := str(task.params[name]))[:200]
            if name in photos and re.match(PHOTO, value):
                shown = partial(widgets.picture, f"/files/photo/{value}", "Photo by the task's creator")
            widgets.fact(label(name, known.get(name, {})), shown, "wrap")


_TRANSACTIONS: widgets.Columns[Transaction] = (
    widgets.Column("What", lambda one: _draw_transaction(one), "wrap"),
    widgets.Column("Gas", lambda one: f"{one.gas_used:,}" if one.gas_used else "–", "number wide-only"),
    widgets.Column("Fee (ETH)", lambda one: _fee(one.fee_wei), "number wide-only"),
    widgets.Column("Hash", lambda one: widgets.hash_text(one.tx_hash)),
)


def _fee(fee_wei: str | None) -> str:
    return "–" if fee_wei is None else number(Decimal(fee_wei) / 10**18, 8)


def _draw_transactions(transactions: list[Transaction], problem: str) -> None:
    if problem:
        widgets.notice(problem)
    else:
        widgets.table("Transactions of this task", _TRANSACTIONS, transactions, "No transactions known.")


def _draw_transaction(transaction: Transaction) -> None:
    told = [name for name in transaction.events if name not in _TOKEN_EVENTS] or transaction.events
    widgets.Text("span", ", ".join(map(phrase, told)))
    sender = transaction.sender_name or short(transaction.sender or "unknown")
    widgets.Text("div", f"{frame.when(transaction.time_s)} by {sender}", "soft")
