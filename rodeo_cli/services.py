"""Commands about services, and about who is paid for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from rodeo.bus import queries
from rodeo.display.formatting import (
    known_in_words,
    namers_in_words,
)
from rodeo.errors import InvalidRequest
from rodeo.site.config import Site
from rodeo_cli import formatting
from rodeo_cli.common import (
    DEFAULT_SITE,
    PARTICIPANTS,
    JsonOption,
    SiteOption,
    connected,
    print_listing,
    reports_errors,
    say,
    send_command,
    site_pace,
)
from rodeo_cli.formatting import iec, worth
from rodeo_cli.layout import Row
from rodeo_cli.task_words import party

services = typer.Typer(help="List and change the services that participants offer.", no_args_is_help=True)


@services.command("list")
@reports_errors
def list_services(site: SiteOption = DEFAULT_SITE, as_json: JsonOption = False) -> None:
    """List the services on offer."""
    with connected(site) as (loaded, bus):
        reply = queries.ask(bus, loaded.org, queries.SERVICES)
        dated = any(one.rests_until or one.bond_locked_until for one in reply.services)
        pace = site_pace(loaded, bus) if dated and not as_json else None
    now_s = None if pace is None else pace.now_s
    rows = (
        Row(
            (str(one.id), one.kind, party(one.provider_name, one.provider), iec(one.price_iec), one.state),
            note=_service_note(one, loaded, now_s),
        )
        for one in reply.services
    )
    print_listing(reply, as_json, ("id", "kind", "provider", "price", "state"), rows, folds=(1, 2))


def _service_note(service: queries.Offer, site: Site, now_s: float | None) -> str:
    told = [known_in_words(service, lambda time_s: formatting.moment(time_s, site), now_s)]
    if service.stood_back:
        told.append("stands back: its provider rests, or works or waits with another service")
    if namers := namers_in_words(service):
        told.append(namers)
    if not service.agrees:
        told.append(
            "gets only tasks under the judge before: its provider has not agreed to the present one "
            f"(`rodeo service agree {service.id}`)"
        )
    if service.set_aside_iec:
        told.append(f"{iec(service.set_aside_iec)} of its bond are set aside until its cases end")
    return "; ".join(told)


ServiceArgument = Annotated[
    int, typer.Argument(min=1, help="The service, by its number in `rodeo service list`.")
]


ProviderOption = Annotated[
    str | None,
    typer.Option("--as", help="Its provider; looked up by default.", autocompletion=PARTICIPANTS),
]


@services.command("price")
@reports_errors
def price(
    service_id: ServiceArgument,
    price: Annotated[str, typer.Argument(help="Price of each future task, in IEC.")],
    site: SiteOption = DEFAULT_SITE,
    participant: ProviderOption = None,
) -> None:
    """Change a service's price. A task in progress keeps the old price."""
    service = change_service(site, service_id, participant, price_iec=price)
    say(f"Service {service_id} will cost {iec(service['price_iec'])} from its next task on.")


_STATES = {
    "pause": (
        "paused",
        "Take no new tasks. A task in progress continues.",
        "Service {0} is paused. Resume it with `rodeo service resume {0}`.",
    ),
    "resume": ("active", "Take tasks again.", "Service {0} takes tasks again."),
    "withdraw": (
        "retired",
        "End an offer for good and refund the rest of its bond. A task in progress continues.\n\n"
        "Whoever is paid for the provider's work may do this, too, for instance when the provider's key is "
        "lost.",
        "Service {0} is withdrawn for good. Offer a new one with `rodeo service offer`.",
    ),
}
"""Command -> the state that it gives a service, its help, and what it prints."""


def _changes_state(state: str, done: str) -> Callable[..., None]:
    def command(
        service_id: ServiceArgument, site: SiteOption = DEFAULT_SITE, participant: ProviderOption = None
    ) -> None:
        change_service(site, service_id, participant, state=state)
        say(done.format(service_id))

    return reports_errors(command)


for _word, (_state, _help, _done) in _STATES.items():
    services.command(_word, help=_help)(_changes_state(_state, _done))


def change_service(
    site: Path,
    service_id: int,
    participant: str | None,
    command: str = "update_service",
    **change: str | int,
) -> dict[str, Any]:
    """Send a command about the service in its provider's name; returns it as it was, with the change. Another
    participant can only retire it, if it is paid for the provider's work.

    Raises InvalidRequest when there is none, or its provider has no name here.
    """
    with connected(site) as (loaded, bus):
        # They are numbered from 1 and listed in that order.
        one_page = {"offset": service_id - 1, "limit": 1}
        services = queries.ask(bus, loaded.org, queries.SERVICES, **one_page).services
        service = next((one for one in services if one.id == service_id), None)
        if service is None:
            raise InvalidRequest(
                f"there is no service {service_id}; `rodeo service list` shows them", service_id=service_id
            )
        provider = service.provider_name
        retires = participant is not None and change.get("state") == "retired"
        if not retires and (provider is None or participant not in (None, provider)):
            raise InvalidRequest(
                f"service {service_id} belongs to another participant than {participant}"
                if participant
                else f"service {service_id} belongs to a provider whose key is not on this site",
                service_id=service_id,
                provider=provider or service.provider,
            )
        request = {"service_id": service_id, **change}
        send_command(loaded, bus, participant or provider or "", command, **request)
    managed = command == "update_service" and change.get("state") != "retired"
    if provider in [robot.name for robot in loaded.robots] and managed:
        say(
            f"{provider} manages its own service and will soon overwrite this change. To stop it from taking "
            f"work, run `rodeo robot pause {provider}`. To change its price, set price_iec of its kind in "
            "the site file."
        )
    return service.model_dump(mode="json") | change


@services.command("payout")
@reports_errors
def payout(
    address: Annotated[str, typer.Argument(help="Who is paid from now on: an address or a participant.")],
    participant: Annotated[str, typer.Option("--as", help="The participant that was paid until now.")],
    site: SiteOption = DEFAULT_SITE,
    provider: Annotated[
        str | None, typer.Option(help="Whose payments; by default those of the participant itself.")
    ] = None,
) -> None:
    """Have payments for a provider's work, its bonds and stakes go to another address.

    A provider can do this once. From then on only the address that is paid can name the next one, so that
    whoever steals the provider's key cannot take what it earns. Nobody undoes a mistake in the address.
    """
    from rodeo.dao import Participant  # takes its time to import

    whose = provider or participant
    with connected(site) as (loaded, bus):
        Participant(bus, loaded.org, participant).set_payout(address, whose)
        paid = queries.ask(bus, loaded.org, queries.WALLET, account=whose)
    if paid.payout is None:
        say(f"{whose} is paid itself.")
        return
    say(f"{party(paid.payout_name, paid.payout)} is paid for what {whose} does, and alone can change this.")


@reports_errors
def wallet(
    name: Annotated[str | None, typer.Argument(help="One participant; all by default.")] = None,
    site: SiteOption = DEFAULT_SITE,
    as_json: JsonOption = False,
) -> None:
    """Show balances."""
    with connected(site) as (loaded, bus):
        known = queries.ask(bus, loaded.org, queries.WALLETS).wallets
    wallets = [one for one in known if name in (None, one.name)]
    if not wallets:
        raise InvalidRequest("no such wallet", name=name, known=[one.name for one in known])
    rows = (
        Row(
            (
                one.name,
                worth(one.balance_iec, loaded),
                one.address,
                "itself" if one.payout is None else party(one.payout_name, one.payout),
            )
        )
        for one in wallets
    )
    document = wallets if name is None else wallets[0]
    print_listing(document, as_json, ("name", "balance", "address", "is paid"), rows, folds=(0,))
