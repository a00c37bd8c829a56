"""The story of a dispute: who ruled and voted, who challenged with which stake, and who got what."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from decimal import Decimal
from typing import Literal

from pydantic import BaseModel

from rodeo.bus.messages import JUDGES, Amount, DaoEvent
from rodeo.bus.queries import Organization, Wallet
from rodeo.chain.artifacts import ORACLES
from rodeo.display.formatting import iec

What = Literal["ruled", "challenged", "lost", "paid", "settled"]


class Step(BaseModel):
    """One event of it. Accounts are named where the site knows them."""

    attempt: int
    time_s: float
    """Site time."""
    what: What
    text: str
    """As a sentence."""
    who: list[str]
    """Whoever voted for the ruling, challenged it, lost a stake or was paid."""
    amount_iec: Amount | None
    """Paid by the ruling, staked, lost or paid."""


def happened(events: Iterable[DaoEvent]) -> list[DaoEvent]:
    """Without those that a reorganization took back."""
    kept: dict[int, DaoEvent] = {}
    for event in events:
        if event.name == "EventUndone":
            kept.pop(event.args["undone_seq"], None)
        else:
            kept[event.seq] = event
    return list(kept.values())


def accounts(organization: Organization, wallets: Sequence[Wallet]) -> dict[str, str]:
    """Address -> the name of its owner: judges, keys that hold roles, accounts of participants."""
    judges = [*organization.judges, *(one for bench in organization.committees for one in bench.judges)]
    holders = [one for some in organization.roles.values() for one in some]
    found = {one.key: one.name for one in judges} | {one.address: one.name for one in holders}
    found |= {one.payout: f"{one.name}'s payout account" for one in wallets if one.payout}
    found |= {one.address: one.name for one in wallets}
    return {address: name for address, name in found.items() if name}


def story(
    events: Iterable[DaoEvent], organization: Organization, wallets: Sequence[Wallet] = ()
) -> list[Step]:
    """In order, of each attempt that a judge with several instances ruled on; `events` are a task's."""
    names = _Names(organization, wallets)
    return list(_steps(happened(events), names))


def _steps(events: list[DaoEvent], names: _Names) -> Iterator[Step]:
    attempt = 0
    # The event of its instance comes before that of the ruling itself, in the same transaction.
    amounts = {one.tx_hash: one.args["amount_iec"] for one in events if one.name == "Ruled"}
    for event in events:
        args = event.args
        attempt = args.get("attempt", attempt)
        said = _TELLS[event.name](event, names, amounts) if event.name in _TELLS else None
        if said is not None:
            what, text, who, amount_iec = said
            yield Step(
                attempt=attempt, time_s=event.time_s, what=what, text=text, who=who, amount_iec=amount_iec
            )


_Said = tuple[What, str, list[str], Decimal | None]


def _ruled(event: DaoEvent, names: _Names, amounts: dict[str, str]) -> _Said | None:
    args, instance = event.args, event.args["instance"]
    if args["ruling"] == "none":
        return None
    voters = [names.seat(instance, seat) for seat in range(64) if int(args["voters"]) >> seat & 1]
    paid = Decimal(amounts.get(event.tx_hash, "0")) if args["ruling"] == "accepted" else None
    said = args["ruling"].replace("_", " ") + ("" if paid is None else f", {iec(paid)}")
    return "ruled", f"{JUDGES[instance]} ruled {said}: {', '.join(voters)} voted for it", voters, paid


def _challenged(event: DaoEvent, names: _Names, _amounts: dict[str, str]) -> _Said:
    who, stake = names.account(event.args["challenger"]), Decimal(event.args["stake_iec"])
    text = f"{who} challenged that with {iec(stake)} at stake: {event.args['reason']}"
    return "challenged", text, [who], stake


def _lost(event: DaoEvent, names: _Names, _amounts: dict[str, str]) -> _Said:
    who = names.seat_at(event.args["committee"], event.args["seat"])
    amount = Decimal(event.args["amount_iec"])
    return "lost", f"{who} lost {iec(amount)} for a ruling that was overturned", [who], amount


def _paid(event: DaoEvent, names: _Names, _amounts: dict[str, str]) -> _Said:
    who, amount = names.account(event.args["account"]), Decimal(event.args["amount_iec"])
    return "paid", f"{who} got {iec(amount)} of the stakes", [who], amount


def _settled(event: DaoEvent, _names: _Names, _amounts: dict[str, str]) -> _Said:
    void = ": the judge was removed, and everybody has its stake back" if event.args["voided"] else ""
    return "settled", f"the case was closed{void}", [], None


_TELLS: dict[str, Callable[[DaoEvent, _Names, dict[str, str]], _Said | None]] = {
    "InstanceRuled": _ruled,
    "Challenged": _challenged,
    "StakeLost": _lost,
    "StakePaid": _paid,
    "CaseSettled": _settled,
}


class _Names:
    """Accounts and seats as people know them."""

    def __init__(self, organization: Organization, wallets: Sequence[Wallet]) -> None:
        contracts = organization.contracts.model_dump(by_alias=True)
        committees = [organization.judges, *(by.judges for by in organization.committees)]
        self._seats = [{one.seat: one.name or one.key for one in judges} for judges in committees]
        names = [ORACLES, *(by.name for by in organization.committees)]
        self._committees = {contracts.get(name, ""): number for number, name in enumerate(names)}
        self._accounts = accounts(organization, wallets) | {organization.address: "the treasury"}

    def account(self, address: str) -> str:
        return self._accounts.get(address, address)

    def seat(self, instance: int, seat: int) -> str:
        known = self._seats[instance] if instance < len(self._seats) else {}
        return known.get(seat, f"seat {seat}")

    def seat_at(self, committee: str, seat: int) -> str:
        return self.seat(self._committees.get(committee, len(self._seats)), seat)
