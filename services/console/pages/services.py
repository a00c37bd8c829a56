"""Services: offers, how well their providers did, the keys that may sign."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.bus import queries
from rodeo.dao import cannot_do
from rodeo.display.formatting import (
    iec,
    kind,
    known_in_words,
    namers_in_words,
    party,
    share,
    short,
    voids_in_words,
)
from rodeo.text.strict_json import Json
from services.console.actions import ORGANIZATION, speaks_for
from services.console.pages import frame, widgets
from services.console.pages.forms import ask_command
from services.console.pages.frame import Console
from services.console.pages.rules import Rules, judged_by


class ServicesPage:
    def __init__(self, console: Console) -> None:
        self._console = console
        person = frame.user()
        self._refresh = frame.follow_async(console, "events", self._load)
        offers = person.has(Role.OPERATOR, Role.EXECUTOR)
        with widgets.card("On offer", button=("Offer a service", "add", self._offer) if offers else None):
            self._services = widgets.Section(self._draw_services).waiting()
        with widgets.card("Rules"):
            self._rules = widgets.Section(Rules(console, self._refresh).draw).waiting()
        with widgets.card("Participants"):
            self._participants = widgets.Section(partial(_draw_participants, console)).waiting()
        register = "Register a key", "add", partial(self._ask, "register_device")
        with widgets.card("Device keys", button=register if person.has(Role.ADMINISTRATOR) else None):
            self._devices = widgets.Section(self._draw_devices).waiting()

    async def _load(self) -> None:
        answer = self._console.queries.ask
        services = (await frame.ask(answer, queries.SERVICES)).services
        participants = (await frame.ask(answer, queries.PARTICIPANTS)).participants
        devices = (await frame.ask(answer, queries.DEVICES)).devices
        self._organization = await frame.ask(answer, queries.ORGANIZATION)
        self._services.show(services)
        self._participants.show(participants)
        self._devices.show(devices)
        self._rules.show(self._organization)

    async def _ask(self, name: str, known: Json | None = None, now: Json | None = None) -> None:
        await ask_command(self._console, name, self._refresh, known, now)

    # -- services --------------------------------------------------------------------------------------

    def _draw_services(self, services: list[queries.Offer]) -> None:
        columns: widgets.Columns[queries.Offer] = (
            widgets.Column("Service", _service_name),
            widgets.Column("Provider", partial(_provider, self._console), "wide-only"),
            widgets.Column("State", _service_state),
            widgets.Column("Price", lambda one: iec(one.price_iec), "number"),
            widgets.Column("Reputation", lambda one: share(one.reputation / 64), "number wide-only"),
            widgets.Column("Done / rejected / late", _record, "number wide-only"),
            widgets.Column("", self._service_menu, "number"),
        )
        widgets.table("Services on offer", columns, services, "Nobody offers a service yet.")

    def _service_menu(self, service: queries.Offer) -> None:
        person, provider = frame.user(), service.provider_name
        own = provider is not None and speaks_for(person, provider)
        if service.state == "retired" or not (own or person.has(Role.ADMINISTRATOR)):
            return
        this = {"service_id": service.id}
        mine = this | {"participant": provider}

        def item(text: str, command: str, known: Json, now: Json | None = None) -> None:
            ui.menu_item(text, partial(self._ask, command, known, now))

        about = f"service {service.id}"
        with ui.button(icon="more_vert").props(f'flat dense round aria-label="Change {about}"'), ui.menu():
            if own:
                if not service.agrees:
                    ui.menu_item("Agree to the present judge", partial(self._agree, service))
                now: Json = {"price_iec": f"{service.price_iec:f}", "state": service.state}
                item("Price, pause, resume or retire", "update_service", mine, now)
                if provider != ORGANIZATION:  # its contract cannot say it for its own services
                    now = {"namers": service.namers, "max_void_percent": service.max_void_percent}
                    item("Who may name it", "set_namers", mine, now)
            if person.has(Role.ADMINISTRATOR):
                if service.state == "suspended":
                    item("Reinstate", "reinstate_service", this)
                else:
                    item("Suspend", "suspend_service", this)

    @widgets.on_page
    async def _agree(self, service: queries.Offer) -> None:
        judged = next((one for one in self._organization.kinds if one.kind == service.kind), None)
        told = [
            ("Judged by", "" if judged is None else judged_by(judged)),
            ("Bond that stands for it", iec(service.bond_iec)),
        ]
        known = {"service_id": service.id, "participant": service.provider_name}
        await ask_command(self._console, "agree", self._refresh, known, told=told)

    async def _offer(self) -> None:
        person = frame.user()
        participant = ORGANIZATION if person.has(Role.OPERATOR) else person.participant or ""
        if not participant:
            ui.notify("Your account works as no participant; an administrator can say which", type="warning")
            return
        allowed = {
            one.kind: kind(one.kind)
            for one in self._organization.kinds
            if one.allowed and not cannot_do(self._console.site, participant, one.kind)
        }
        if not allowed:
            ui.notify(f"The organization accepts no kind of work that {participant} can do", type="warning")
            return
        known = {"participant": participant}
        offered, start = {"kind": allowed}, {"price_iec": "100"}
        await ask_command(self._console, "register_service", self._refresh, known, start, offered=offered)

    # -- devices ---------------------------------------------------------------------------------------

    def _draw_devices(self, devices: list[queries.OwnedDevice]) -> None:
        columns: widgets.Columns[queries.OwnedDevice] = (
            widgets.Column("Device", _device_name),
            widgets.Column("Key", lambda one: widgets.hash_text(one.address)),
            widgets.Column("Owner", lambda one: party(one.owner_name, one.owner), "wide-only"),
            widgets.Column("Since", lambda one: frame.when(one.registered), "wide-only"),
            widgets.Column("", self._device_end, "number"),
        )
        widgets.table("Device keys", columns, devices, "No key is registered to sign evidence yet.")

    def _device_end(self, device: queries.OwnedDevice) -> None:
        if device.revoked:
            widgets.badge(device.revoked_because or "revoked")
        elif frame.user().has(Role.ADMINISTRATOR):
            name = f"Revoke the {device.role} key of {device.name} {short(device.address)}"
            ui.button(
                "Revoke", on_click=partial(self._ask, "revoke_device", {"device": device.address})
            ).props(f'flat dense color=negative aria-label="{name}"')
        else:
            widgets.badge("active")


def _device_name(device: queries.OwnedDevice) -> None:
    widgets.Text("strong", device.name)
    widgets.Text("div", device.role, "soft")


def _role(name: str) -> str:
    """ORACLE_ROLE -> oracle"""
    return name.removesuffix("_ROLE").removeprefix("DEFAULT_").lower()


def _service_name(service: queries.Offer) -> None:
    widgets.Text("strong", f"{service.id} · {kind(service.kind)}")
    if service.description:
        widgets.Text("div", service.description[:120], "soft wrap")


def _record(service: queries.Offer) -> str:
    return f"{service.completed} / {service.rejected} / {service.expired}"


def _known(console: Console, known: queries.Known) -> str:
    """What the contracts know of a provider, as of now."""
    pace = console.live.heartbeats.pace
    return known_in_words(known, frame.when, None if pace is None else pace.now_s)


def _provider(console: Console, service: queries.Offer) -> None:
    widgets.Text("div", party(service.provider_name, service.provider))
    widgets.Text("div", _known(console, service), "soft wrap")


_NEWCOMER = (
    "Three accepted tasks for others, or the organization's word, make a newcomer proven. A newcomer works "
    "with one service at a time, and rests after each task that it gives back or misses."
)
_PARTICIPANTS: widgets.Columns[queries.Person] = (
    widgets.Column("Participant", lambda one: _person(one)),
    widgets.Column("Address", lambda one: widgets.hash_text(one.address), "wide-only"),
    widgets.Column("Roles", lambda one: ", ".join(map(_role, one.roles_on_chain)) or one.role or "–", "wrap"),
    widgets.Column("Balance", lambda one: iec(one.balance_iec), "number"),
    widgets.Column("Posted", lambda one: f"{sum(one.created.values()):,}", "number wide-only"),
    widgets.Column("Void", lambda one: _voids(one), "wrap wide-only"),
    widgets.Column("Done", lambda one: f"{one.executed.get('settled', 0):,}", "number wide-only"),
)


def _draw_participants(console: Console, participants: list[queries.Person]) -> None:
    known = widgets.Column[queries.Person]("Known as", partial(_known, console), "wrap wide-only")
    widgets.table("Participants", (*_PARTICIPANTS[:3], known, *_PARTICIPANTS[3:]), participants)
    widgets.Text("p", _NEWCOMER, "soft wide-only")


def _person(one: queries.Person) -> None:
    """Its name, and who is paid for its work where it is another."""
    widgets.Text("div", one.name or "stranger")
    if one.payout is not None:
        widgets.Text("div", "paid for its work:", "soft")
        widgets.Text("div", one.payout_name) if one.payout_name else widgets.hash_text(one.payout)


def _voids(one: queries.Person) -> object:
    words = voids_in_words(one.voids)
    return widgets.Text("span", words, "alarming") if one.many_voids else words or "–"


def _service_state(service: queries.Offer) -> None:
    widgets.badge(service.state)
    if not service.agrees:
        widgets.Text("div", "has not agreed to the present judge", "soft wrap")
    if service.stood_back:
        why = "its provider rests, or works or waits with another service"
        widgets.Text("div", f"stands back: {why}", "soft wrap")
    if namers := namers_in_words(service):
        widgets.Text("div", namers, "soft wrap")
    if service.set_aside_iec:
        widgets.Text("div", f"{iec(service.set_aside_iec)} set aside", "soft")
