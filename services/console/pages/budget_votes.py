"""Money that members split by votes: what each recipient gets, how a member votes, how shares are paid."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.display.formatting import count, iec, party, split_in_words
from services.console.pages import frame, widgets
from services.console.pages.frame import Console

SHOWN = 20
LOOK_S = 5.0
"""How often a page looks whether a vote has ended or a delay has passed: no event says so."""


class BudgetVotesSection:
    """Part of a page, empty where no budget vote was ever opened."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._refresh = frame.follow_async(console, "events", self._load)
        self._all = widgets.Section(self._draw)
        ui.timer(LOOK_S, self._refresh)

    async def _load(self) -> None:
        answer = await frame.ask(self._console.queries.ask, queries.BUDGET_VOTES, limit=SHOWN)
        self._all.show(answer.budget_votes)

    def _draw(self, budget_votes: list[queries.BudgetVote]) -> None:
        if budget_votes:
            widgets.cards("Budget vote", budget_votes, self._draw_one)

    def _draw_one(self, one: queries.BudgetVote) -> None:
        member = frame.user().participant if frame.user().has(Role.EXECUTOR) else None
        own = next((ballot for ballot in one.ballots if member and ballot.voter_name == member), None)
        with widgets.facts():
            widgets.fact("Amount", iec(one.amount_iec))
            widgets.fact("Members vote until", frame.when(one.end_s))
            voters = ", ".join(party(ballot.voter_name, ballot.voter) for ballot in one.ballots)
            widgets.fact("Voted", voters or "nobody", "wrap")
            if own is not None:
                used = f"{own.credits_used} of {one.credits} credits: {split_in_words(one, own)}"
                widgets.fact("Your votes", used, "wrap")
        with ui.element("ul").classes("list"):
            for to in one.recipients:
                self._draw_recipient(one, to)
        with ui.element("div").classes("line"):
            if one.state == "open" and member is not None:
                words = "Vote" if own is None else "Change your votes"
                ui.button(words, on_click=partial(self._vote, one, own)).props("outline")
            if one.state == "ended" and frame.may("pay_budget_share"):
                ui.button("Pay the shares", on_click=partial(self._pay, one)).props("outline")

    def _draw_recipient(self, one: queries.BudgetVote, to: queries.BudgetShare) -> None:
        name = party(to.name, to.address)
        if one.state == "open":
            gets = f"would get {iec(to.share_iec)}"
        elif to.paid_iec is not None:
            gets = f"was paid {iec(to.paid_iec)}"
        else:
            gets = f"gets {iec(to.share_iec)}, not paid yet" if to.share_iec else "gets nothing"
        with ui.element("li"):
            widgets.Text("span", name, "title").props(f'title="{to.address}"')
            widgets.Text("span", f"{count(to.votes, 'vote')}, {gets}", "soft end")
            # The contract takes a budget vote about nothing.
            widgets.progress_bar(float(to.share_iec / (one.amount_iec or 1)), f"Share of {name}")

    @widgets.on_page
    async def _pay(self, one: queries.BudgetVote) -> None:
        due = [to for to in one.recipients if to.share_iec and to.paid_iec is None]
        lines = [(party(to.name, to.address), iec(to.share_iec)) for to in due]
        if not await widgets.confirm("Pay these out of the treasury?", lines, "Pay"):
            return
        for to in due:
            request = {"budget_vote": one.number, "recipient": to.address}
            # A share that cannot be paid now, because the treasury is empty, keeps nobody else's.
            await frame.act(self._console, "pay_budget_share", request, f"Paid {party(to.name, to.address)}")
        self._refresh()

    @widgets.on_page
    async def _vote(self, one: queries.BudgetVote, own: queries.BudgetBallot | None) -> None:
        before = [0] * len(one.recipients) if own is None else own.votes
        entries: list[ui.number] = []

        def votes() -> list[int]:
            return [int(entry.value or 0) for entry in entries]

        def recount() -> None:
            used = sum(one * one for one in votes())
            over = used > one.credits
            total.set_text(f"{used} of {one.credits} credits" + (": too many" if over else ""))
            button.set_enabled(not over)

        async def cast() -> None:
            given = {to.address: number for to, number in zip(one.recipients, votes(), strict=True)}
            request = {"budget_vote": one.number, "votes": given}
            done = f"Voted in budget vote {one.number}"
            if await frame.act(self._console, "cast_budget_vote", request, done):
                dialog.submit(True)

        with widgets.modal(f"Budget vote {one.number}") as dialog:
            dialog.props("no-backdrop-dismiss")
            widgets.Text("p", f"n votes for a recipient cost n × n of your {one.credits} credits.", "soft")
            with ui.element("div").classes("form").style("width: 100%"):
                for to, number in zip(one.recipients, before, strict=True):
                    label = f"Votes for {party(to.name, to.address)}"
                    entry = ui.number(label, value=number, min=0, precision=0, on_change=recount)
                    entries.append(entry.props("outlined dense").classes("whole"))
            total = widgets.Text("p", "").props('role="status"')
            button = widgets.dialog_buttons(dialog, "Vote", cast)
            recount()
        if await dialog:
            self._refresh()
