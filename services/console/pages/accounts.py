"""People and their roles, for administrators; one's own passphrase and tokens, for everybody."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from rodeo.access.accounts import User, workers
from rodeo.access.roles import Role
from rodeo.display.formatting import wall_moment
from rodeo.text.strict_json import Json
from services.console.pages import frame, widgets
from services.console.pages.frame import Console


class AccountsPage:
    def __init__(self, console: Console) -> None:
        self._console = console
        self._name = frame.user().name
        if frame.user().has(Role.ADMINISTRATOR):
            with widgets.card("People", button=("New account", "person_add", self._create)):
                self._people = widgets.Section(self._draw_people).waiting()
        with ui.element("div").classes("grid"):
            new = "New token", "add", self._issue
            with ui.element("div").classes("stack span-7"), widgets.card("Your tokens", button=new):
                told = "With a token a program may do under /api whatever you may do here."
                widgets.Text("p", f"{told} Their times are the wall clock's.", "soft")
                self._tokens = widgets.Section(self._draw_tokens).waiting()
            with ui.element("div").classes("stack span-5"), widgets.card("Your passphrase"):
                widgets.Text("p", "A new passphrase ends all your sessions, including this one.", "soft")
                ui.button("Set a new one", on_click=self._set_passphrase).props("outline").style(
                    "align-self: start"
                )
        # After the page is there: the framework gives up on one that takes long to answer.
        ui.timer(0, self.load, once=True)

    async def load(self) -> None:
        if frame.user().has(Role.ADMINISTRATOR):
            self._people.show(await frame.ask(self._console.accounts.users))
        self._tokens.show(await frame.ask(self._console.accounts.tokens, self._name))

    @widgets.on_page
    async def _act(self, name: str, request: Json, done: str) -> Json | None:
        reply = await frame.act(self._console, name, request, done)
        if reply is not None:
            await self.load()
        return reply

    async def _ask(
        self, title: str, fields: dict[str, widgets.Field], action: str, name: str, fixed: Json
    ) -> None:
        """Ask for roles and participant of an account, and what else there is in `fields`."""

        async def give(answer: dict[str, str]) -> bool:
            roles = [role for role in answer["roles"].split(",") if role]
            request = {**fixed, **answer, "roles": roles, "participant": answer["participant"] or None}
            return await self._act(name, request, f"Done: {title.lower()}") is not None

        await widgets.ask_form(title, fields, action, give)

    # -- people ----------------------------------------------------------------------------------------

    def _draw_people(self, people: list[User]) -> None:
        columns: widgets.Columns[User] = (
            widgets.Column("Name", lambda one: one.name),
            widgets.Column("Roles", lambda one: ", ".join(sorted(one.roles)) or "may look", "wrap"),
            widgets.Column("Works as", lambda one: one.participant or "–", "wide-only"),
            widgets.Column("", self._person_end, "number"),
        )
        widgets.table("Accounts", columns, people)

    def _person_end(self, person: User) -> None:
        if person.disabled:
            widgets.badge("disabled", "bad")
        with (
            ui.button(icon="more_vert").props(f'flat dense round aria-label="Change {person.name}"'),
            ui.menu(),
        ):
            ui.menu_item("Change roles", partial(self._change, person))
            if person.name != self._name:
                word = "Enable" if person.disabled else "Disable"
                ui.menu_item(word, partial(self._set_disabled, person, not person.disabled))

    def _may(self, person: User | None = None) -> dict[str, widgets.Field]:
        """Roles and participant, as they are now."""
        roles, works_as = ("", "") if person is None else (",".join(person.roles), person.participant or "")
        all_roles = {role.value: role.value for role in Role}
        names = {"": "nobody"} | {name: name for name in workers(self._console.site)}
        return {
            "roles": widgets.Field("Roles; none: read-only", roles, all_roles, several=True),
            "participant": widgets.Field("Participant, for an executor", works_as, names),
        }

    async def _create(self) -> None:
        secret = widgets.Field("First passphrase, 12 characters or more", secret="new-password")
        fields = {"name": widgets.Field("Name"), "passphrase": secret, **self._may()}
        await self._ask("New account", fields, "Make it", "create_user", {})

    @widgets.on_page
    async def _change(self, person: User) -> None:
        fixed = {"name": person.name, "disabled": person.disabled}
        title, fields = f"Roles of {person.name}", self._may(person)
        await self._ask(title, fields, "Change them", "change_user", fixed)

    @widgets.on_page
    async def _set_disabled(self, person: User, disabled: bool) -> None:
        request = {
            "name": person.name,
            "roles": sorted(person.roles),
            "participant": person.participant,
            "disabled": disabled,
        }
        lines = [("Account", person.name), ("Sessions and tokens", "end at once")]
        if not disabled or await widgets.confirm("Disable this account?", lines, "Disable it", danger=True):
            await self._act(
                "change_user", request, f"{person.name} is {'disabled' if disabled else 'enabled'}"
            )

    # -- one's own -------------------------------------------------------------------------------------

    def _draw_tokens(self, tokens: list[Json]) -> None:
        columns: widgets.Columns[Json] = (
            widgets.Column("For", lambda one: one["label"]),
            widgets.Column("Made", lambda one: wall_moment(one["created_s"]), "plain wide-only"),
            widgets.Column("Last used", lambda one: wall_moment(one["used_s"])),
            widgets.Column("", self._token_end, "number"),
        )
        widgets.table("Your tokens", columns, tokens, "You have no tokens.")

    def _token_end(self, token: Json) -> None:
        request = {"token_id": token["id"]}
        revoke = partial(self._act, "revoke_token", request, "The token is revoked")
        button = ui.button("Revoke", on_click=revoke).props("flat dense color=negative")
        button.props["aria-label"] = f"Revoke {token['label']}"

    async def _issue(self) -> None:
        async def issue(answer: dict[str, str]) -> bool:
            reply = await self._act("issue_token", answer, "")
            if reply is None:
                return False
            lines = [
                ("Token", reply["token"]),
                ("Shown", "It is shown only once. Keep it with your other secrets."),
            ]
            await widgets.confirm("Your new token", lines, "I have it")
            return True

        await widgets.ask_form("New token", {"label": widgets.Field("What is it for?")}, "Make it", issue)

    async def _set_passphrase(self) -> None:
        async def give(answer: dict[str, str]) -> bool:
            request = {"name": self._name, **answer}
            if await frame.act(self._console, "set_passphrase", request) is None:
                return False
            ui.navigate.to("/login")
            return True

        fields = {
            "current": widgets.Field("Current passphrase", secret="current-password"),
            "passphrase": widgets.Field("New passphrase", secret="new-password"),
        }
        await widgets.ask_form("Your passphrase", fields, "Set it", give)
