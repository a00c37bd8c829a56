"""Commands about services and those who offer them."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import replace
from decimal import Decimal
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from rodeo.bus.messages import Id, Iec, Kind, Namers, Party
from rodeo.chain.contracts import abi
from rodeo.commands.declare import Command, Line, command
from rodeo.commands.errors import AlreadyOffered, DailyLimitReached, UnknownService
from rodeo.commands.examples import OTHER
from rodeo.commands.people import BY_ADMINISTRATOR, BY_PROVIDER
from rodeo.errors import InvalidRequest

if TYPE_CHECKING:
    from rodeo.chain.encoding import Call
    from rodeo.commands.desk import Desk


@command("ros_dao", "robot_agent", "charger", "operator", console=BY_PROVIDER)
class RegisterService(Command):
    """Offer to do tasks of a kind: from then on they may be assigned to the provider."""

    kind: Kind = Field(description="The kind of task.", examples=["window_cleaning"])
    price_iec: Iec = Field(description="Price in IEC.", examples=["40"])
    max_bond_iec: Iec | None = Field(
        None,
        description=(
            "The highest bond to agree to; by default what the organization asks for as far as the "
            "bridge knows."
        ),
    )
    auto_accept: bool | None = Field(
        None,
        description=(
            "Accept every task that the service is assigned. Otherwise each needs `accept_task`. By "
            "default only services of kinds that the oracle can check accept every task."
        ),
    )
    description: str = Field(default="", max_length=2000, description="Description for people.")

    def calls(self, desk: Desk) -> list[Call]:
        desk.require_kind(self.kind)
        desk.require_able(self.kind)
        self._require_room_for(desk)
        price = desk.currency.to_units(self.price_iec)
        bond, max_bond = self._bond(desk), self._max_bond(desk)
        desk.require_funds(desk.address, bond)
        auto_accept = self.auto_accept
        if auto_accept is None:  # what nobody can check before it is assigned is free text
            auto_accept = not desk.kinds.by_people(self.kind)
        offer = desk.calls.register_service(self.kind, price, max_bond, auto_accept, self.description)
        return [*_wake_up(desk), *desk.escrow_approval(bond), offer]

    def _bond(self, desk: Desk) -> int:
        """What a new service has to lock, wei."""
        return desk.currency.to_units(Decimal((desk.index.rules.setting("terms") or {}).get("bond_iec", 0)))

    def _max_bond(self, desk: Desk) -> int:
        """The highest bond that the new service agrees to lock, wei."""
        most_iec = self.max_bond_iec
        return self._bond(desk) if most_iec is None else desk.currency.to_units(most_iec)

    def sent(self, desk: Desk, reply: Future[dict[str, Any]]) -> None:
        desk.offering[self.kind] = self.request_id, reply

    def _require_room_for(self, desk: Desk) -> None:
        kind = self.kind
        request_id, sent = desk.offering.get(kind, (None, None))
        if sent is not None and not sent.done():
            if request_id is not None and request_id == self.request_id:
                return  # the same one again, which is known
            raise AlreadyOffered(
                f"{desk.participant} is offering {kind} already; its transaction is not mined yet", kind=kind
            )
        offers, most = (
            desk.index.services.offers(desk.address, kind),
            desk.names.most_offers(desk.participant, kind),
        )
        if len(offers) >= most:
            service = offers[-1]
            raise AlreadyOffered(
                f"{desk.participant} offers {kind} already, as service {service['id']}, which is "
                f"{service['state']}: change that one's price or state, or withdraw it first",
                most_offers=most,
                kind=kind,
                service_id=service["id"],
                state=service["state"],
                price_iec=desk.currency.text(service["price"]),
            )

    def spends(self, desk: Desk) -> int:
        return self._max_bond(desk)


@command(
    "ros_dao",
    "robot_agent",
    "charger",
    "operator",
    console=replace(BY_PROVIDER, for_good={"state": "retired"}),
    proposable=True,
    of_administrator=False,
)
class UpdateService(Command):
    """Price, pause, resume or retire a service. What is left out stays as it is."""

    service_id: Id = Field(description="The service, by its number in `rodeo service list`.", examples=[2])
    price_iec: Iec | None = Field(
        None, description="Price of each later task, in IEC. By default it stays.", examples=["40"]
    )
    state: Literal["active", "paused", "retired"] | None = Field(
        None, description="A provider that retires a service ends it for good."
    )

    def calls(self, desk: Desk) -> list[Call]:
        service = desk.index.services.get(self.service_id)
        if service is None:
            raise UnknownService("no such service", service_id=self.service_id)
        if self.state == "active":
            desk.require_able(service["kind"])
        price = service["price"] if self.price_iec is None else desk.currency.to_units(self.price_iec)
        state = abi.ServiceState[(self.state or service["state"]).upper()]
        woken = _wake_up(desk) if state is abi.ServiceState.ACTIVE else []
        return [*woken, desk.calls.update_service(self.service_id, price, state)]

    def proposed(self, desk: Desk) -> list[Call]:
        if self.state is None:
            # As it is now is not as it is when this is executed, days later.
            raise InvalidRequest("a proposal names the state that the service has afterwards, too")
        service = desk.index.services.get(self.service_id)
        if service is not None and service["provider"] != desk.client.organization:
            raise InvalidRequest(
                "the organization does not offer this service, so it cannot change it",
                service_id=self.service_id,
                provider=service["provider"],
            )
        return self.calls(desk)


@command(
    "ros_dao",
    "robot_agent",
    "charger",
    line=Line(
        "service agree {service_id}",
        "Service {service_id} gets tasks under the present judge of its kind.",
        of_provider=True,
    ),
    console=BY_PROVIDER,
)
class Agree(Command):
    """Agree that a service gets tasks that the present judge of its kind decides about.

    Its bond then stands for them. Until then it gets only tasks that were posted under the judge before.
    """

    service_id: Id = Field(description="The service, by its number in `rodeo service list`.", examples=[2])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.calls.agree(self.service_id)]


def _namers_in_words(said: Mapping[str, Any]) -> str:
    who = "proven creators" if said["namers"] == "proven" else said["namers"]
    return f"Tasks of {who} may name service {said['service_id']}."


@command(
    "ros_dao",
    line=Line(
        "service set-namers {service_id} {namers}",
        _namers_in_words,
        spelled={"max_void_percent": "--max-void"},
        of_provider=True,
    ),
    console=BY_PROVIDER,
)
class SetNamers(Command):
    """Set whose tasks may name a service: those of proven creators (as at first), nobody's, or anybody's."""

    service_id: Id = Field(description="The service, by its number in `rodeo service list`.", examples=[2])
    namers: Namers = Field("proven", description="proven, nobody, anybody.")
    max_void_percent: Annotated[int, Field(ge=0, le=100)] = Field(
        0,
        description=(
            "Refuse creators of whose tasks that named somebody more than this part (%) ended void. 0"
            " refuses nobody."
        ),
    )

    def calls(self, desk: Desk) -> list[Call]:
        namers = abi.Namers[self.namers.upper()]
        return [desk.client.calls.set_namers(self.service_id, namers, self.max_void_percent)]


@command("robot_agent", "operator")
class SetPayout(Command):
    """Have what the contracts owe a provider for work, bonds and stakes paid to another address. A provider
    names one once. Then only the address that is paid can name the next."""

    payout: Party = Field(
        description=(
            "The account that is paid from now on. The provider itself gets the right to choose back."
        ),
        examples=[OTHER],
    )
    provider: Party | None = Field(None, description="The provider that is paid; by default the sender.")

    def calls(self, desk: Desk) -> list[Call]:
        provider = desk.address if self.provider is None else desk.names.address(self.provider)
        return [desk.client.calls.set_payout(provider, desk.payee("payout", self.payout))]

    def _require_bounded(self, desk: Desk) -> None:
        """Whoever is named is paid all that the provider earns from then on. Raises DailyLimitReached."""
        known = (desk.address, desk.names.payout(desk.participant))
        if desk.has_daily_iec and desk.payee("payout", self.payout) not in known:
            raise DailyLimitReached(
                "a wallet with a daily limit names no payout address but its own and the site file's: set "
                "the robot's payout there, or remove the limit",
                participant=desk.participant,
                payout=self.payout,
            )

    def spends(self, desk: Desk) -> int:
        self._require_bounded(desk)
        return 0


@command(
    line=Line(
        "organization suspend-provider {account}",
        "{account} and its services are suspended. Running tasks continue.",
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class SuspendProvider(Command):
    """Give no service of a provider more tasks, and let it offer no others."""

    account: Party = Field(description="A participant's name or an address.", examples=["alice"])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.organization_calls.suspend_provider(desk.names.address(self.account))]


@command(
    line=Line(
        "organization reinstate-provider {account}",
        "{account} may offer services again. Those that it has stay suspended until you reinstate them.",
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class ReinstateProvider(Command):
    """Let a suspended provider offer services again. Reinstate those that it has one by one."""

    account: Party = Field(description="A participant's name or an address.", examples=["alice"])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.organization_calls.reinstate_provider(desk.names.address(self.account))]


@command(
    line=Line(
        "organization suspend {service_id}",
        "Service {service_id} is suspended. It gets no tasks until you reinstate it.",
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class SuspendService(Command):
    """Give a service no more tasks."""

    service_id: Id = Field(description="The service, by its number in `rodeo service list`.", examples=[2])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.organization_calls.suspend_service(self.service_id)]


@command(
    line=Line(
        "organization reinstate {service_id}",
        "Service {service_id} is reinstated. It stays paused until its provider resumes it.",
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class ReinstateService(Command):
    """Let a suspended service return: paused, until its provider activates it."""

    service_id: Id = Field(description="The service, by its number in `rodeo service list`.", examples=[2])

    def calls(self, desk: Desk) -> list[Call]:
        return [desk.client.organization_calls.reinstate_service(self.service_id)]


@command(
    line=Line(
        "organization vouch {account}",
        lambda said: (
            f"The organization vouches for {said['account']}{'' if said['vouched'] else ' no longer'}."
        ),
        spelled={"vouched": "--on/--off"},
    ),
    console=BY_ADMINISTRATOR,
    proposable=True,
)
class Vouch(Command):
    """Vouch for a provider, so that it is proven before it has done any work. Members are vouched for.

    A proven provider works with all its services at once, and does not rest when it gives a task back."""

    account: Party = Field(description="A participant's name or an address.", examples=["alice"])
    vouched: bool = Field(True, description="Vouch, or do so no longer.")

    def calls(self, desk: Desk) -> list[Call]:
        account = desk.names.address(self.account)
        return [desk.client.organization_calls.vouch_for(account, self.vouched)]


def _wake_up(desk: Desk) -> list[Call]:
    """What comes before an offer of a provider that let too many attempts pass without a proof."""
    return [desk.client.calls.wake_up()] if desk.index.services.is_asleep(desk.address) else []
