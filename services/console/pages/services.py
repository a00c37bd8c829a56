"""Services: offers, how well their providers did, the keys that may sign, and the organization's rules."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from decimal import Decimal
from functools import partial
from typing import Any

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.dao import cannot_do
from rodeo.display.formatting import (
    iec,
    kind,
    known_in_words,
    moment,
    namers_in_words,
    party,
    quorum_in_words,
    share,
    short,
    span,
    voids_in_words,
    windows_in_words,
)
from rodeo.errors import RodeoError
from rodeo.kinds import KindError
from rodeo.text.strict_json import Json
from services.console.actions import ORGANIZATION, speaks_for
from services.console.pages.forms import ask_command, choose_command
from services.console.pages.frame import (
    Console,
    act,
    ask,
    follow_async,
    frame,
    problem_section,
    stale,
    user,
)
from services.console.pages.widgets import (
    Field,
    Section,
    Text,
    ask_form,
    badge,
    card,
    confirm,
    empty,
    fact,
    facts,
    hash_text,
    on_page,
    table,
)

_UNSAID = "unsaid"
"""Stands for no choice."""
POLICIES = {
    "first_come": "First come, first served",
    "lowest_price": "Lowest price",
    "highest_reputation": "Highest reputation",
}


def register(console: Console) -> None:
    @ui.page("/services")
    def services() -> None:
        with frame(console, "Services and participants", "/services"):
            ServicesPage(console)


class ServicesPage:
    def __init__(self, console: Console) -> None:
        self._console = console
        person = user()
        self._problem = problem_section()
        with card("Services") as head:
            if person.has(Role.OPERATOR, Role.EXECUTOR):
                with head:
                    ui.button("Offer a service", icon="add", on_click=self._offer).props("flat dense")
            self._services = Section(self._draw_services).waiting()
        with card("Participants"):
            self._participants = Section(partial(_draw_participants, console)).waiting()
        with ui.element("div").classes("grid"):
            with ui.element("div").classes("stack span-7"), card("Device keys") as head:
                if person.has(Role.ADMINISTRATOR):
                    with head:
                        ui.button(
                            "Register a key", icon="add", on_click=partial(self._ask, "register_device")
                        ).props("flat dense")
                self._devices = Section(self._draw_devices).waiting()
            with ui.element("div").classes("stack span-5"), card("Rules"):
                self._rules = Section(self._draw_rules).waiting()
        self._refresh = follow_async(console, "events", self._load)

    async def _load(self) -> None:
        answer = self._console.queries.ask
        try:
            services = (await ask(answer, queries.SERVICES)).services
            participants = (await ask(answer, queries.PARTICIPANTS)).participants
            devices = (await ask(answer, queries.DEVICES)).devices
            self._organization = await ask(answer, queries.ORGANIZATION)
        except RodeoError as error:
            self._problem.show(stale(error))
            return
        self._problem.show("")
        self._services.show(services)
        self._participants.show(participants)
        self._devices.show(devices)
        self._rules.show(self._organization)

    @on_page
    async def _act(self, name: str, request: Json, done: str) -> bool:
        """Whether it was done."""
        if await act(self._console, name, request, done) is None:
            return False
        self._refresh()
        return True

    async def _ask(self, name: str, known: Json | None = None, now: Json | None = None) -> None:
        await ask_command(self._console, name, self._refresh, known, now)

    # -- services --------------------------------------------------------------------------------------

    def _draw_services(self, services: list[queries.Offer]) -> None:
        if not services:
            empty("Nobody offers a service yet.")
            return
        table(
            "Services on offer",
            [
                ("Service", ""),
                ("Provider", "wide-only"),
                ("State", ""),
                ("Price", "number"),
                ("Reputation", "number wide-only"),
                ("Done / rejected / late", "number wide-only"),
                ("", "number"),
            ],
            [
                (
                    partial(_service_name, one),
                    partial(_provider, self._console, one),
                    partial(_service_state, one),
                    iec(one.price_iec),
                    share(one.reputation / 64),
                    f"{one.completed} / {one.rejected} / {one.expired}",
                    partial(self._service_menu, one),
                )
                for one in services
            ],
        )

    def _service_menu(self, service: queries.Offer) -> None:
        person, provider = user(), service.provider_name
        own = provider is not None and speaks_for(person, provider)
        if service.state == "retired" or not (own or person.has(Role.ADMINISTRATOR)):
            return
        about = f"service {service.id}"
        with ui.button(icon="more_vert").props(f'flat dense round aria-label="Change {about}"'), ui.menu():
            if own:
                if not service.agrees:
                    ui.menu_item("Agree to the present judge", partial(self._agree, service))
                ui.menu_item("Change the price", partial(self._price, service))
                if provider != ORGANIZATION:  # its contract cannot say it for its own services
                    now = {"namers": service.namers, "max_void_percent": service.max_void_percent}
                    known = {"service_id": service.id, "participant": provider}
                    name_it = partial(self._ask, "set_namers", known, now)
                    ui.menu_item("Who may name it", name_it)
                if service.state in ("active", "short"):
                    ui.menu_item("Pause", partial(self._set_state, service, "paused"))
                elif service.state == "paused":
                    ui.menu_item("Resume", partial(self._set_state, service, "active"))
                ui.menu_item("Retire for good", partial(self._set_state, service, "retired"))
            if person.has(Role.ADMINISTRATOR):
                if service.state == "suspended":
                    request = {"service_id": service.id}
                    ui.menu_item(
                        "Reinstate", partial(self._act, "reinstate_service", request, f"{about} works again")
                    )
                else:
                    ui.menu_item("Suspend", partial(self._suspend, service))

    @on_page
    async def _price(self, service: queries.Offer) -> None:
        await ask_form(
            f"New price of service {service.id}",
            {"price_iec": Field("Price (IEC)", f"{service.price_iec:f}")},
            "Set the price",
            lambda answer: self._update(service, answer, f"Service {service.id} has a new price"),
        )

    @on_page
    async def _set_state(self, service: queries.Offer, state: str) -> None:
        if state == "retired":
            lines = [
                ("Service", f"{service.id} · {kind(service.kind)}"),
                ("After that", "it cannot come back"),
            ]
            if not await confirm("Retire this service?", lines, "Retire it", danger=True):
                return
        await self._update(service, {"state": state}, f"Service {service.id} is {state}")

    @on_page
    async def _agree(self, service: queries.Offer) -> None:
        judged = next((one for one in self._organization.kinds if one.kind == service.kind), None)
        lines = [
            ("Service", f"{service.id} · {kind(service.kind)}"),
            ("Judged by", "" if judged is None else _judges(judged)),
            ("Bond that stands for it", iec(service.bond_iec)),
        ]
        if await confirm("Agree to the present judge?", lines, "Agree"):
            request = {"service_id": service.id, "participant": service.provider_name}
            await self._act("agree", request, f"Service {service.id} has agreed")

    async def _update(self, service: queries.Offer, change: Json, done: str) -> bool:
        request = {"service_id": service.id, "participant": service.provider_name, **change}
        return await self._act("update_service", request, done)

    @on_page
    async def _suspend(self, service: queries.Offer) -> None:
        lines = [
            ("Service", f"{service.id} · {kind(service.kind)}"),
            ("Until", "an administrator reinstates it"),
        ]
        if await confirm("Suspend this service?", lines, "Suspend it", danger=True):
            await self._act(
                "suspend_service", {"service_id": service.id}, f"Service {service.id} is suspended"
            )

    async def _offer(self) -> None:
        person = user()
        participant = ORGANIZATION if person.has(Role.OPERATOR) else person.participant or ""
        if not participant:
            ui.notify("Your account works as no participant; an administrator can say which", type="warning")
            return
        site = self._console.site
        allowed = [
            one.kind
            for one in self._organization.kinds
            if one.allowed and not cannot_do(site, participant, one.kind)
        ]
        if not allowed:
            ui.notify(f"The organization accepts no kind of work that {participant} can do", type="warning")
            return
        await ask_form(
            f"Offer a service of {participant}",
            {
                "kind": Field("Kind", choices={name: kind(name) for name in allowed}),
                "price_iec": Field("Price (IEC)", "100"),
                "description": Field("For people"),
            },
            "Offer it",
            lambda answer: self._act(
                "register_service", {"participant": participant, **answer}, "The service is on offer"
            ),
        )

    # -- devices ---------------------------------------------------------------------------------------

    def _draw_devices(self, devices: list[queries.OwnedDevice]) -> None:
        if not devices:
            empty("No key is registered to sign evidence yet.")
            return
        table(
            "Device keys",
            [
                ("Key", ""),
                ("Role", ""),
                ("Name", ""),
                ("Owner", ""),
                ("Since", "wide-only"),
                ("", "number"),
            ],
            [
                (
                    partial(hash_text, one.address),
                    one.role,
                    one.name,
                    party(one.owner_name, one.owner),
                    moment(one.registered),
                    partial(self._device_end, one),
                )
                for one in devices
            ],
        )

    def _device_end(self, device: queries.OwnedDevice) -> None:
        if device.revoked:
            badge(device.revoked_because or "revoked")
        elif user().has(Role.ADMINISTRATOR):
            name = f"Revoke the {device.role} key of {device.name} {short(device.address)}"
            ui.button(
                "Revoke", on_click=partial(self._ask, "revoke_device", {"device": device.address})
            ).props(f'flat dense color=negative aria-label="{name}"')
        else:
            badge("active")

    # -- rules -----------------------------------------------------------------------------------------

    def _draw_kinds(self, organization: queries.Organization) -> None:
        table(
            "Kinds of work",
            [
                ("Kind of work", ""),
                ("Judged by", ""),
                ("Time", "wrap wide-only"),
                ("Counts up to", "number wide-only"),
                ("Rules", "wide-only"),
                ("", ""),
            ],
            [
                (
                    kind(one.kind),
                    _judges(one),
                    windows_in_words(one) or "–",
                    iec(one.reference_price_iec) if one.max_window_s else "–",
                    partial(_rules_hashes, one.rules_sha256),
                    partial(self._kind_end, one),
                )
                for one in organization.kinds
            ],
        )

    def _draw_rules(self, organization: queries.Organization) -> None:
        terms = organization.terms
        failures = terms.max_failures
        with facts():
            fact("Chosen by", POLICIES.get(organization.policy, organization.policy))
            fact("Open to", "members only" if organization.members_only else "everybody")
            fact("Bond", iec(terms.bond_iec))
            fact("Penalty for a failure", iec(terms.penalty_iec))
            fact("Suspended after", f"{failures} failures in a row" if failures else "never")
            if voids := voids_in_words(organization.voids):
                fact(
                    "Void attempts",
                    partial(Text, "span", voids, "alarming") if organization.many_voids else voids,
                    "wrap",
                )
        self._draw_kinds(organization)
        _draw_judges(organization)
        if user().has(Role.ADMINISTRATOR):
            with ui.element("div").classes("line tight"):
                ui.button("Allow a kind", on_click=partial(self._allow_kind, "")).props("outline dense")
                ui.button("Times of a kind", on_click=self._change_times).props("outline dense")
                now = {"policy": organization.policy, **terms.model_dump(mode="json")}
                more = partial(choose_command, self._console, Role.ADMINISTRATOR, self._refresh, now)
                ui.button("Other commands", on_click=more).props("outline dense")

    def _kind_end(self, one: queries.KindRules) -> None:
        if not user().has(Role.ADMINISTRATOR):
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

    @on_page
    async def _change_hashes(self, one: queries.KindRules) -> None:
        async def change(answer: dict[str, str]) -> bool:
            request = {"kind": one.kind, "rules_sha256": answer["rules_sha256"]}
            if answer["action"] == "retire":
                return await self._act("retire_rules", request, "No more tasks are posted under these rules")
            request |= {"judge": one.judge}
            return await self._act("allow_kind", request, "New tasks are judged by these rules")

        await ask_form(
            f"Rules of {kind(one.kind)}",
            {
                "rules_sha256": Field("Hash of the rules (0x…)", await ask(self._installed_rules, one.kind)),
                "action": Field(
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

    @on_page
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

        await ask_form(
            f"Allow {kind(name)}" if name else "Allow a kind of work",
            {
                "kind": Field("Name, for example window_cleaning", name),
                "judge": Field("Judged by", choices=judges),
                "rules_sha256": Field(
                    "Hash of the rules (0x…), where the oracle judges", await ask(self._installed_rules, name)
                ),
            },
            "Allow it",
            allow,
        )

    @on_page
    async def _change_times(self) -> None:
        judges = {one.kind: one.judge for one in self._organization.kinds if one.allowed}

        async def change(answer: dict[str, str]) -> bool:
            request = {name: value for name, value in answer.items() if value}
            request |= {"judge": judges[answer["kind"]]}
            return await self._act("allow_kind", request, f"The times of {kind(answer['kind'])} are set")

        await ask_form(
            "Times of a kind, in seconds, and its price; what is left empty stays",
            {
                "kind": Field("Kind of work", choices={name: kind(name) for name in judges}),
                "min_window_s": Field("Shortest time to work"),
                "max_window_s": Field("Longest time to work"),
                "grace_s": Field("Time to accept a task or give it back"),
                "reference_price_iec": Field("An attempt counts in a record up to (IEC)"),
                "audit_window_s": Field("Auditors may rule for, when the judge cannot; then it is void"),
            },
            "Set them",
            change,
        )


def _draw_judges(organization: queries.Organization) -> None:
    if organization.judges:
        table(
            "Oracles that have to agree",
            [("Oracle", ""), ("Works for", ""), ("Stake", "number"), ("Key", "wide-only")],
            [
                (
                    one.name or str(one.seat),
                    party(one.owner_name, one.owner),
                    _stake(one, organization.stake_needed(one)),
                    partial(hash_text, one.key),
                )
                for one in organization.judges
            ],
        )
    for number, committee in enumerate(organization.committees):
        table(
            "Judges of the appeal" if number else "Judges of challenges",
            [
                ("Judge of the appeal" if number else "Judge of challenges", ""),
                ("Stake", "number"),
                ("Key", "wide-only"),
            ],
            [
                (
                    one.name or str(one.seat),
                    _stake(one, committee.stake_needed(one)),
                    partial(hash_text, one.key),
                )
                for one in committee.judges
            ],
        )


def _role(name: str) -> str:
    """ORACLE_ROLE -> oracle"""
    return name.removesuffix("_ROLE").removeprefix("DEFAULT_").lower()


def _service_name(service: queries.Offer) -> None:
    Text("strong", f"{service.id} · {kind(service.kind)}")
    if service.description:
        Text("div", service.description[:120], "soft wrap")


def _known(console: Console, known: queries.Known) -> str:
    """What the contracts know of a provider, as of now."""
    pace = console.live.heartbeats.pace
    return known_in_words(known, moment, None if pace is None else pace.now_s)


def _provider(console: Console, service: queries.Offer) -> None:
    Text("div", party(service.provider_name, service.provider))
    Text("div", _known(console, service), "soft wrap")


def _draw_participants(console: Console, participants: list[queries.Person]) -> None:
    table(
        "Participants",
        [
            ("Participant", ""),
            ("Address", "wide-only"),
            ("Roles", "wrap"),
            ("Known as", "wrap wide-only"),
            ("Balance", "number"),
            ("Paid for its work", "wrap wide-only"),
            ("Posted", "number wide-only"),
            ("Void", "wrap wide-only"),
            ("Done", "number wide-only"),
        ],
        [
            (
                one.name or "stranger",
                partial(hash_text, one.address),
                ", ".join(map(_role, one.roles_on_chain)) or one.role or "–",
                _known(console, one),
                iec(one.balance_iec),
                "itself" if one.payout is None else one.payout_name or partial(hash_text, one.payout),
                f"{sum(one.created.values()):,}",
                partial(Text, "span", voids_in_words(one.voids), "alarming")
                if one.many_voids
                else voids_in_words(one.voids) or "–",
                f"{one.executed.get('settled', 0):,}",
            )
            for one in participants
        ],
    )


def _rules_hashes(rules: list[str]) -> None:
    """Hashes, newest first: new tasks get that one."""
    for one in reversed(rules):
        hash_text(one)


def _stake(judge: queries.Judge, needed: Decimal) -> str:
    """Empty where it neither has nor needs a stake."""
    if judge.stake_iec < needed:
        return f"{iec(judge.stake_iec)} of {iec(needed)}"
    return iec(judge.stake_iec) if judge.stake_iec else ""


def _judges(one: queries.KindRules) -> str:
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


def _service_state(service: queries.Offer) -> None:
    badge(service.state)
    if not service.agrees:
        Text("div", "has not agreed to the present judge", "soft wrap")
    if service.stood_back:
        Text("div", "stands back: its provider rests, or works or waits with another service", "soft wrap")
    if namers := namers_in_words(service):
        Text("div", namers, "soft wrap")
    if service.set_aside_iec:
        Text("div", f"{iec(service.set_aside_iec)} set aside", "soft")
