"""The organization's rules: policy, terms, kinds of work, judges."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from functools import partial

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
from services.console.pages import frame, widgets
from services.console.pages.forms import ask_command, choose_command, commands_of
from services.console.pages.frame import Console

POLICIES = {
    "first_come": "First come, first served",
    "lowest_price": "Lowest price",
    "highest_reputation": "Highest reputation",
}


class Rules:
    """The organization's rules, with what an administrator changes of them; `refresh` shows them anew."""

    def __init__(self, console: Console, refresh: Callable[[], None]) -> None:
        self._console = console
        self._refresh = refresh

    def _draw_kinds(self, organization: queries.Organization) -> None:
        columns: widgets.Columns[queries.KindRules] = (
            widgets.Column("Kind of work", lambda one: kind(one.kind), "plain-wide"),
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
                known = {"allowed": True}
                allow = partial(ask_command, self._console, "allow_kind", self._refresh, known)
                ui.button("Allow a kind", on_click=allow).props("outline dense")
                now = {"policy": organization.policy, **terms.model_dump(mode="json")}
                names = commands_of(Role.ADMINISTRATOR)
                more = partial(choose_command, self._console, names, self._refresh, now)
                ui.button("Other commands", on_click=more).props("outline dense")

    def _kind_end(self, one: queries.KindRules) -> None:
        if not frame.user().has(Role.ADMINISTRATOR):
            return
        ask = partial(ask_command, self._console)
        # What nobody has set yet gets its default.
        now = {name: value for name, value in one.model_dump(mode="json").items() if value}
        known = {"kind": one.kind, "allowed": True}
        change = partial(ask, "allow_kind", self._refresh, known, now | {"rules_sha256": ""})
        name = kind(one.kind)
        with ui.button(icon="more_vert").props(f'flat dense round aria-label="Change {name}"'), ui.menu():
            ui.menu_item("Judge, times and rules" if one.allowed else "Allow", change)
            if one.allowed:
                ui.menu_item("Forbid", partial(self._forbid, one))
            if len(one.rules_sha256) > 1:
                offered = {"rules_sha256": {rules: short(rules) for rules in one.rules_sha256}}
                known = {"kind": one.kind}
                retire = partial(ask, "retire_rules", self._refresh, known, offered=offered)
                ui.menu_item("Retire rules", retire)

    @widgets.on_page
    async def _forbid(self, one: queries.KindRules) -> None:
        request, done = {"kind": one.kind, "allowed": False}, f"{kind(one.kind)} is forbidden"
        if await frame.act(self._console, "allow_kind", request, done) is not None:
            self._refresh()


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
