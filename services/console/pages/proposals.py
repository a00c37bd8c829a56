"""Budget votes, and what was proposed and what became of it, with the calls that each proposal would make:
here members vote, and proposals are queued, executed and withdrawn."""

from __future__ import annotations

from typing import get_args

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.bus.messages import Support
from rodeo.commands import COMMANDS
from rodeo.display.formatting import calls_in_words, party, phrase, span
from rodeo.errors import snake_case
from services.console.actions import proposer_of, summary_of
from services.console.pages import frame, widgets
from services.console.pages.budget_votes import LOOK_S, BudgetVotesSection
from services.console.pages.forms import Proposing, choose_command
from services.console.pages.frame import Console

SHOWN = 50


_STEPS = (
    ("Queue", "queue_proposal", ("succeeded",)),
    ("Execute", "execute_proposal", ("queued", "ready")),
    ("Withdraw", "cancel_proposal", ("waiting", "ready")),
)
"""What is done to a proposal as a whole: the button, its action, and the states in which it can be done."""
_MADE_BY = {
    "changeKey": "change_judge_key",
    "open": "open_budget_vote",
    "seat": "seat_judge",
    "updateDelay": "set_delay",
    "vouchFor": "vouch",
}
"""Functions of contracts -> the command that calls them, where that has another name."""


def decided(organization: queries.Organization) -> str:
    """How this organization decides, and what happens to a proposal."""
    if not organization.delay_s:
        return "The administrator's key acts at once here, and nothing is proposed."
    then = f"{span(organization.delay_s)} later anybody may have it carried out."
    if organization.decided_by == "vote":
        return f"Members propose and vote. What they accept is queued, and {then}"
    return f"An administrator proposes, and {then}"


def does(call: queries.ProposedCall) -> str:
    """What a call does, in the words of the command that makes it."""
    if call.contract.startswith("0x"):
        return f"call {call.contract}, which is no contract of the organization"
    if not call.function:
        return f"call {call.contract}, which has no such function"
    if call.function == "multicall" and "calls" in call.args:
        return "; ".join(_does(call.contract, one["function"]) for one in call.args["calls"])
    return _does(call.contract, call.function)


def _does(contract: str, function: str) -> str:
    model = COMMANDS.get(_MADE_BY.get(function) or snake_case(function))
    return f"{phrase(function)} of the {phrase(contract).lower()}" if model is None else summary_of(model)


class ProposalsPage:
    def __init__(self, console: Console) -> None:
        self._console = console
        BudgetVotesSection(console)
        self._refresh = frame.follow_async(console, "events", self._load)
        with ui.element("div").classes("line"):
            self._decided = widgets.Text("span", "", "soft")
            self._propose = ui.button("Propose", icon="add", on_click=self._ask).props("outline")
            self._propose.visible = False
        self._proposing: Proposing | None = None
        self._all = widgets.Section(self._draw).waiting()
        ui.timer(LOOK_S, self._refresh)
        frame.follow(console, "organization", self._offer)

    async def _load(self) -> None:
        asked = self._console.queries.ask
        self._all.show((await frame.ask(asked, queries.PROPOSALS, limit=SHOWN)).proposals)

    def _offer(self) -> None:
        """Let who may propose, and say how the organization decides."""
        if (organization := self._console.live.summary.organization) is None:
            return
        self._decided.set_text(decided(organization))
        participant = proposer_of(frame.user(), organization.decided_by)
        if participant is not None and organization.delay_s:
            self._proposing = Proposing(participant, decided(organization))
        self._propose.visible = self._proposing is not None

    async def _ask(self) -> None:
        names = sorted(name for name, one in COMMANDS.items() if one.declared.proposable)
        await choose_command(self._console, names, self._refresh, proposal=self._proposing)

    def _draw(self, proposals: list[queries.Proposal]) -> None:
        if not proposals:
            widgets.empty("Nothing was proposed yet.")
            return
        widgets.cards("Proposal", proposals, self._draw_one)

    def _draw_one(self, one: queries.Proposal) -> None:
        widgets.Text("p", one.description, "wrap")
        with widgets.facts():
            widgets.fact("Would do", "; ".join(dict.fromkeys(map(does, one.calls))), "wrap")
            widgets.fact("Would call", calls_in_words(one.calls), "wrap")
            if one.vote_end_s is None:
                widgets.fact("Proposed", frame.when(one.created_s))
            else:
                widgets.fact(
                    "Proposed by", f"{party(one.proposer_name, one.proposer)}, {frame.when(one.created_s)}"
                )
                for support in get_args(Support):
                    voters = [party(b.voter_name, b.voter) for b in one.ballots if b.support == support]
                    widgets.fact(support.capitalize(), f"{one.votes[support]} {', '.join(voters)}")
                widgets.fact("Votes count until", frame.when(one.vote_end_s))
            if one.ready_s is not None:
                widgets.fact("Can be executed from", frame.when(one.ready_s))
        with ui.element("div").classes("line"):
            voted = {ballot.voter_name for ballot in one.ballots}
            member = frame.user().participant if frame.user().has(Role.EXECUTOR) else None
            if one.state == "active" and member is not None and member not in voted:
                for support in get_args(Support):
                    self._button(one, f"Vote {support}", "cast_vote", support=support)
            for word, action, states in _STEPS:
                if one.state in states and frame.may(action):
                    button = self._button(one, word, action)
                    if one.state == "queued" and one.ready_s is not None:
                        self._enable_from(one.ready_s, button)

    def _button(self, one: queries.Proposal, word: str, action: str, **more: str) -> ui.button:
        @widgets.on_page
        async def take() -> None:
            lines = [("Proposal", one.description), ("Would call", calls_in_words(one.calls))]
            title = f"{word} {'on ' if more else ''}proposal {one.number}?"
            if await widgets.confirm(title + " It cannot be changed." * bool(more), lines, word):
                request = {"proposal": one.number, **more}
                await frame.act(
                    self._console, action, request, f"Done: {word.lower()}, proposal {one.number}"
                )
                self._refresh()

        return ui.button(word, on_click=take).props("outline")

    def _enable_from(self, ready_s: float, button: ui.button) -> None:
        def look() -> None:
            pace = self._console.live.heartbeats.pace
            button.set_enabled(pace is None or pace.now_s >= ready_s)

        look()
        ui.timer(LOOK_S, look)
