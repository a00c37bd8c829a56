"""What a command's checks and calls are made from, handed in by the bridge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

from rodeo.bus.messages import ORGANIZATION
from rodeo.chain.signed_requests import UNLIMITED
from rodeo.commands.errors import (
    CannotDo,
    HasToBeProposed,
    InsufficientFunds,
    UnknownKind,
    UnknownTask,
)
from rodeo.errors import InvalidRequest
from rodeo.evidence.store import Store
from rodeo.kinds import Kinds
from rodeo.money.currency import Currency
from rodeo.site.sections import EconomyConfig
from rodeo.text.addresses import typed_address

if TYPE_CHECKING:
    from rodeo.chain.calls import ParticipantCalls
    from rodeo.chain.client import ChainClient
    from rodeo.chain.encoding import Call

Row = Mapping[str, Any]


class TaskRecords(Protocol):
    def get(self, task_id: int, /) -> Row | None: ...


class ServiceRecords(Protocol):
    def get(self, service_id: int, /) -> Row | None: ...
    def offers(self, provider: str, kind: str, /) -> Sequence[Row]: ...
    def active_prices(self, kind: str, /) -> list[int]: ...
    def is_asleep(self, provider: str, /) -> bool: ...


class RuleRecords(Protocol):
    def kind(self, kind: str, /) -> Row | None: ...
    def kinds(self) -> list[str]: ...
    def all_kinds(self) -> Sequence[Row]: ...
    def of(self, kind: str, judge: str | None = None, /) -> list[str]: ...
    def number_of(self, kind: str, /) -> int: ...
    def numbers(self) -> Mapping[int, Row]: ...
    def judges(self) -> Sequence[Row]: ...
    def devices(self) -> Sequence[Row]: ...
    def roles(self) -> dict[str, list[str]]: ...
    def setting(self, name: str, /) -> Any: ...


class VoteRecords(Protocol):
    def proposal(self, number: int, /) -> Row | None: ...
    def proposal_number(self, key: str, /) -> int | None: ...
    def budget_vote(self, number: int, /) -> Row | None: ...


class MoneyRecords(Protocol):
    def balance(self, address: str, /) -> int: ...


class Records(Protocol):
    """What the bridge's index knows."""

    @property
    def position(self) -> Any: ...
    @property
    def tasks(self) -> TaskRecords: ...
    @property
    def services(self) -> ServiceRecords: ...
    @property
    def rules(self) -> RuleRecords: ...
    @property
    def votes(self) -> VoteRecords: ...
    @property
    def money(self) -> MoneyRecords: ...


class Directory(Protocol):
    """The site's participants, their addresses and what they can do."""

    @property
    def addresses(self) -> dict[str, str]: ...
    @property
    def keys(self) -> dict[str, str]: ...
    def address(self, who: str, /) -> str: ...
    def key_address(self, who: str, /) -> str: ...
    def name(self, address: str | None, /) -> str | None: ...
    def key_name(self, address: str, /) -> str | None: ...
    def payout(self, name: str, /) -> str | None: ...
    def judge(self, address: str, /) -> str: ...
    def cannot_do(self, name: str, kind: str, /) -> str: ...
    def most_offers(self, name: str, kind: str, /) -> int: ...


@dataclass
class Desk:
    """Where a participant's commands are checked. One thread uses it, the participant's own."""

    participant: str
    client: ChainClient
    index: Records
    names: Directory
    store: Store
    economy: EconomyConfig
    kinds: Kinds
    has_daily_iec: bool = False
    """The wallet has a daily limit of IEC."""
    offering: dict[str, tuple[str | None, Future[dict[str, Any]]]] = field(default_factory=dict)
    """Kind -> `request_id` and reply of the last offer of it that this process has sent."""
    _approved: set[str] = field(default_factory=set)

    @property
    def address(self) -> str:
        """The account that creates, executes and pays on chain."""
        return self.names.addresses[self.participant]

    @property
    def key_address(self) -> str:
        """The account that signs."""
        return self.names.keys[self.participant]

    @property
    def currency(self) -> Currency:
        return self.client.currency

    @property
    def calls(self) -> ParticipantCalls:
        """Direct, or through the Organization contract."""
        return self.client.organization_calls if self.participant == ORGANIZATION else self.client.calls

    def of_organization(self) -> Desk:
        """This desk for calls that the organization makes itself, after a proposal."""
        return replace(self, participant=ORGANIZATION)

    def task(self, task_id: int) -> Row:
        """Raises UnknownTask."""
        task = self.index.tasks.get(task_id)
        if task is None:
            raise UnknownTask("no such task", task_id=task_id)
        return task

    def payee(self, field: str, who: str) -> str:
        """The address of whoever is to be paid: nobody could correct a mistyped one.

        Raises InvalidRequest.
        """
        try:
            return self.names.addresses.get(who) or typed_address(who)
        except ValueError as error:
            raise InvalidRequest(f"{field}: neither a participant nor {error}") from error

    def require_kind(self, kind: str) -> None:
        """Raises UnknownKind."""
        if kind not in self.index.rules.kinds() and not self.client.rules.is_kind_allowed(kind):
            raise UnknownKind(
                "the organization does not accept this kind", kind=kind, known=self.index.rules.kinds()
            )

    def require_able(self, kind: str) -> None:
        """Raises CannotDo."""
        if reason := self.names.cannot_do(self.participant, kind):
            raise CannotDo(reason, participant=self.participant, kind=kind)

    def require_funds(self, account: str, needed: int) -> None:
        """Raises InsufficientFunds."""
        # The index may be a block behind, so that only the node can say no.
        if self.index.money.balance(account) >= needed:
            return
        balance = self.client.token.balance(account)
        if balance < needed:
            raise InsufficientFunds(
                "the account's balance is too low for this",
                account=account,
                name=self.names.key_name(account),
                balance_iec=self.currency.text(balance),
                needed_iec=self.currency.text(needed),
            )

    def require_no_timelock(self, command: str) -> None:
        """Raises HasToBeProposed where the administrator is one: it does `command` after a proposal alone."""
        if not self.client.deployment.has_timelock:
            return
        if self.client.rules.administrator() == self.client.deployment.address("OrganizationTimelock"):
            raise HasToBeProposed(
                "no key does this at once in this organization: propose it with `rodeo organization propose "
                "--why TEXT`, followed by the command",
                command=command,
                delay_s=self.client.decisions.delay_s(),
            )

    def escrow_approval(self, needed: int) -> list[Call]:
        """For what the TaskManager takes. The Organization approved it in its constructor."""
        return [] if self.participant == ORGANIZATION else self.approval(self.client.task_manager, needed)

    def approval(self, spender: str, needed: int) -> list[Call]:
        """What lets `spender` take tokens from this wallet for good; nothing where it may already."""
        if spender in self._approved:
            return []
        allowance = self.client.token.allowance(self.key_address, spender)
        if allowance < needed:
            # Some tokens refuse to change an allowance that is not used up.
            reset = [self.client.calls.approve(spender, 0)] if allowance else []
            return [*reset, self.client.calls.approve(spender, UNLIMITED)]
        if allowance > UNLIMITED // 2:  # never used up
            self._approved.add(spender)
        return []
