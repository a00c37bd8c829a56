"""The organization's rules: policy, terms, kinds of work, judges."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from decimal import Decimal
from functools import partial
from typing import Any

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.display.formatting import (
    iec,
    kind,
    party,
    quorum_in_words,
    short,
    span,
    voids_in_words,
    windows_in_words,
)
from rodeo.kinds import KindError
from rodeo.text.strict_json import Json
from services.console.pages import frame, widgets
from services.console.pages.forms import choose_command, commands_of
from services.console.pages.frame import Console

_UNSAID = "unsaid"
"""Stands for no choice."""
POLICIES = {
    "first_come": "First come, first served",
    "lowest_price": "Lowest price",
    "highest_reputation": "Highest reputation",
}


async def changed(console: Console, refresh: Callable[[], None], name: str, request: Json, done: str) -> bool:
    """Carry out a command and show what it changed; whether it was done."""
    if await frame.act(console, name, request, done) is None:
        return False
    refresh()
    return True


class Rules:
    """The organization's rules, with what an administrator changes of them; `refresh` shows them anew."""

    def __init__(self, console: Console, refresh: Callable[[], None]) -> None:
        self._console = console
        self._refresh = refresh

    async def _act(self, name: str, request: Json, done: str) -> bool:
        return await changed(self._console, self._refresh, name, request, done)

    def _draw_kinds(self, organization: queries.Organization) -> None:
        columns: widgets.Columns[queries.KindRules] = (
            widgets.Column("Kind of work", lambda one: kind(one.kind)),
            widgets.Column("Judged by", judged_by, "wrap"),
            widgets.Column("Time", lambda one: windows_in_words(one) or "–", "wrap wide-only"),
            widgets.Column("Counts up to", _counted, "number wide-only"),
            widgets.Column("Rules", lambda one: _rules_hashes(one.rules_sha256), "wide-only"),
            widgets.Column("", self._kind_end),
        )
        widgets.table("Kinds of work", columns, organization.kinds)

    def draw(self, organization: queries.Organization) -> None:
        terms = organization.terms
        failures = terms.max_failures
        with widgets.facts():
            widgets.fact("Chosen by", POLICIES.get(organization.policy, organization.policy))
            widgets.fact("Open to", "members only" if organization.members_only else "everybody")
            widgets.fact("Bond", iec(terms.bond_iec))
            widgets.fact("Penalty for a failure", iec(terms.penalty_iec))
            widgets.fact("Suspended after", f"{failures} failures in a row" if failures else "never")
            if voids := voids_in_words(organization.voids):
                widgets.fact(
                    "Void attempts",
                    partial(widgets.Text, "span", voids, "alarming") if organization.many_voids else voids,
                    "wrap",
                )
        self._draw_kinds(organization)
        _draw_judges(organization)
        if frame.user().has(Role.ADMINISTRATOR):
            with ui.element("div").classes("line tight"):
                ui.button("Allow a kind", on_click=partial(self._allow_kind, "")).props("outline dense")
                ui.button("Times of a kind", on_click=partial(self._change_times, organization)).props(
                    "outline dense"
                )
                now = {"policy": organization.policy, **terms.model_dump(mode="json")}
                names = commands_of(Role.ADMINISTRATOR)
                more = partial(choose_command, self._console, names, self._refresh, now)
                ui.button("Other commands", on_click=more).props("outline dense")

    def _kind_end(self, one: queries.KindRules) -> None:
        if not frame.user().has(Role.ADMINISTRATOR):
            return
        click: Callable[[], Awaitable[Any]]
        if one.allowed:
            word = "Forbid"
            request = {"kind": one.kind, "allowed": False}
            click = partial(self._act, "allow_kind", request, f"{kind(one.kind)} is forbidden")
        else:
            word, click = "Allow", partial(self._allow_kind, one.kind)
        ui.button(word, on_click=click).props(f'flat dense aria-label="{word} {kind(one.kind)}"')
        if one.allowed:
            label = f"Change the rules of {kind(one.kind)}"
            ui.button("Rules", on_click=partial(self._change_hashes, one)).props(
                f'flat dense aria-label="{label}"'
            )

    @widgets.on_page
    async def _change_hashes(self, one: queries.KindRules) -> None:
        async def change(answer: dict[str, str]) -> bool:
            request = {"kind": one.kind, "rules_sha256": answer["rules_sha256"]}
            if answer["action"] == "retire":
                return await self._act("retire_rules", request, "No more tasks are posted under these rules")
            request |= {"judge": one.judge}
            return await self._act("allow_kind", request, "New tasks are judged by these rules")

        installed = await frame.ask(self._installed_rules, one.kind)
        await widgets.ask_form(
            f"Rules of {kind(one.kind)}",
            {
                "rules_sha256": widgets.Field("Hash of the rules (0x…)", installed),
                "action": widgets.Field(
                    "What to do",
                    choices={
                        "allow": "Judge new tasks by them; older rules stay current",
                        "retire": "Post no more tasks under them; their open tasks keep them",
                    },
                ),
            },
            "Do it",
            change,
        )

    def _installed_rules(self, name: str) -> str:
        """Hash of the rules by which the installed checks judge a kind; empty where people judge it."""
        # Imported here: what the checks use takes its time, and few pages need it.
        from rodeo.checks.rules import rules_hash

        found = self._console.kinds.get(name)
        try:
            return "" if found is None else rules_hash(found) or ""
        except KindError:
            return ""

    @widgets.on_page
    async def _allow_kind(self, name: str) -> None:
        """The judge is named each time: no judge is meant by leaving it out."""
        judges = {_UNSAID: "Choose who judges it", "auditor": "an auditor"}
        if not name or not self._console.kinds.by_people(name):
            judges["oracle"] = "the oracle, where it has checks for it"

        async def allow(answer: dict[str, str]) -> bool:
            if answer["judge"] == _UNSAID:
                ui.notify("Choose who judges this kind of work", type="warning")
                return False
            if not answer["rules_sha256"]:
                del answer["rules_sha256"]
            done = f"{kind(answer['kind'])} is allowed"
            return await self._act("allow_kind", {"allowed": True, **answer}, done)

        installed = await frame.ask(self._installed_rules, name)
        await widgets.ask_form(
            f"Allow {kind(name)}" if name else "Allow a kind of work",
            {
                "kind": widgets.Field("Name, for example window_cleaning", name),
                "judge": widgets.Field("Judged by", choices=judges),
                "rules_sha256": widgets.Field("Hash of the rules (0x…), where the oracle judges", installed),
            },
            "Allow it",
            allow,
        )

    @widgets.on_page
    async def _change_times(self, organization: queries.Organization) -> None:
        judges = {one.kind: one.judge for one in organization.kinds if one.allowed}

        async def change(answer: dict[str, str]) -> bool:
            request = {name: value for name, value in answer.items() if value}
            request |= {"judge": judges[answer["kind"]]}
            return await self._act("allow_kind", request, f"The times of {kind(answer['kind'])} are set")

        await widgets.ask_form(
            "Times of a kind, in seconds, and its price; what is left empty stays",
            {
                "kind": widgets.Field("Kind of work", choices={name: kind(name) for name in judges}),
                "min_window_s": widgets.Field("Shortest time to work"),
                "max_window_s": widgets.Field("Longest time to work"),
                "grace_s": widgets.Field("Time to accept a task or give it back"),
                "reference_price_iec": widgets.Field("An attempt counts in a record up to (IEC)"),
                "audit_window_s": widgets.Field("Auditors may rule for, when the judge cannot; then: void"),
            },
            "Set them",
            change,
        )


def _draw_judges(organization: queries.Organization) -> None:
    benches: list[tuple[str, str, queries.Organization | queries.Committee]] = [
        ("Oracles that have to agree", "Oracle", organization)
    ]
    for number, committee in enumerate(organization.committees):
        of = "the appeal" if number else "challenges"
        benches.append((f"Judges of {of}", f"Judge of {of}", committee))
    seated = [one for one in benches if one[2].judges]
    if seated:
        with ui.element("div").classes("grid"):
            for one in seated:
                with ui.element("div").classes("span-6"):
                    _draw_bench(*one)


def _draw_bench(caption: str, title: str, bench: queries.Organization | queries.Committee) -> None:
    columns: widgets.Columns[queries.Judge] = (
        widgets.Column(title, _judge),
        widgets.Column("Stake", lambda one: _stake(one, bench.stake_needed(one)), "number"),
        widgets.Column("Key", lambda one: widgets.hash_text(one.key), "wide-only"),
    )
    widgets.table(caption, columns, bench.judges)


def _counted(one: queries.KindRules) -> str:
    return iec(one.reference_price_iec) if one.max_window_s else "–"


def _judge(one: queries.Judge) -> None:
    widgets.Text("div", one.name or str(one.seat))
    if one.owner_name != one.name:
        widgets.Text("div", f"works for {party(one.owner_name, one.owner)}", "soft")


def _rules_hashes(rules: list[str]) -> None:
    """Hashes, newest first: new tasks get that one."""
    for one in reversed(rules):
        widgets.hash_text(one)


def _stake(judge: queries.Judge, needed: Decimal) -> str:
    """Empty where it neither has nor needs a stake."""
    if judge.stake_iec < needed:
        return f"{iec(judge.stake_iec)} of {iec(needed)}"
    return iec(judge.stake_iec) if judge.stake_iec else ""


def judged_by(one: queries.KindRules) -> str:
    """The judge of this kind of work, and the one that rules on what it cannot decide."""
    if not one.allowed:
        return "not allowed"
    if one.removed:
        return "nobody: its judge was removed"
    judges = one.judge if one.judge in ("oracle", "auditor") else f"the contract {short(one.judge)}"
    if one.judge == "oracle" and one.votes:
        judges = quorum_in_words(one)
    if one.judge == "auditor" or not one.audit_window_s:
        return judges
    return f"{judges}; auditors for {span(one.audit_window_s)} where it cannot decide, then void"
