"""Providers, and the line in which their services wait for tasks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rodeo.chain.contracts import events
from rodeo.chain.reputation import is_own
from services.bridge import schema
from services.bridge.projection import At, Table
from services.bridge.rows import Rows

AWAKE: dict[str, Any] = {"asleep_until": None, "rests_until": None}
"""Columns of a provider whose proof was accepted, or that the organization vouches for now, or no longer."""

_BOND_DELAY_S = 24 * 3600
"""`BOND_DELAY` of Providers: how long its bonds are locked after a rest began."""


class Providers:
    """Rows of providers; one that no event named yet has the contracts' initial values."""

    def __init__(self, rows: Rows, contracts: Mapping[str, str]) -> None:
        self._rows, self._organization = rows, contracts.get("Organization")

    def get(self, address: str) -> Mapping[str, Any]:
        unknown: dict[str, Any] = {
            "address": address,
            **dict.fromkeys(("failures", "done", "failed", "day", "creator"), 0),
            **dict.fromkeys(("asleep_until", "rests_until", "bond_locked_until", "payout")),
            **dict.fromkeys(("earned", "vouched", "suspended"), False),
            "services": [],
        }
        return self._rows.find(schema.providers, address) or unknown

    def change(self, address: str, **values: Any) -> None:
        self._rows.put(schema.providers, **{**self.get(address), **values})

    def is_organization(self, address: str) -> bool:
        return address == self._organization

    def is_proven(self, address: str) -> bool:
        provider = self.get(address)
        return self.is_organization(address) or provider["earned"] or provider["vouched"]

    def payout_of(self, address: str) -> str:
        return str(self.get(address)["payout"] or address)

    def is_own(self, creator: str, provider: str) -> bool:
        """Whether the task's creator pays itself."""
        devices = {address: self._rows.find(schema.devices, address) for address in (creator, provider)}
        owners = {key: row["owner"] for key, row in devices.items() if row}
        return is_own(creator, provider, owners, self.payout_of(provider))

    def live(self, address: str) -> list[Mapping[str, Any]]:
        """The provider's services that are not over, in the contract's order."""
        return [self._rows.get(schema.services, one) for one in self.get(address)["services"]]

    def is_engaged(self, address: str) -> bool:
        """Whether one of its services works or waits."""
        return any(one["place"] or one["task_id"] is not None for one in self.live(address))


class Line:
    """Services that the contracts free now; in the end each has a task or a place in the line, or stands
    back."""

    def __init__(self, rows: Rows, providers: Providers) -> None:
        self._rows, self._providers = rows, providers
        self._free: list[int] = []

    def free(self, service_id: int) -> None:
        self._free.append(service_id)

    def take(self, service_id: int) -> None:
        """Drop a service that needs no place now."""
        self._free = [one for one in self._free if one != service_id]

    def offer_all(self, address: str) -> None:
        """Offer the provider's services that could work and are in no line, or in the wrong one, as
        ServiceManager."""
        proven = self._providers.is_proven(address)
        for one in self._providers.live(address):
            is_placed = one["place"] and one["waits_as_proven"] == proven
            if not is_placed and one["state"] == "active" and one["task_id"] is None:
                self._rows.change(schema.services, one["id"], place=0)
                self.free(one["id"])

    def place(self, time_s: int) -> None:
        """Place services behind the others, as ServiceManager.enqueue, where they take tasks and had no
        place, unless their provider rests.

        The places of all kinds are numbered together.
        """
        free, self._free = self._free, []
        for service_id in free:
            service = self._rows.get(schema.services, service_id)
            owner, is_idle = service["provider"], service["task_id"] is None
            if service["state"] == "retired" and is_idle and not service["bond"]:
                live = [one for one in self._providers.get(owner)["services"] if one != service_id]
                self._providers.change(owner, services=live)
            proven = self._providers.is_proven(owner)
            rests = not proven and (self._providers.get(owner)["rests_until"] or 0) > time_s
            if service["state"] == "active" and is_idle and not service["place"] and not rests:
                row = self._rows.find(schema.settings, "places")
                place = 1 if row is None else row["value"] + 1
                self._rows.put(schema.settings, name="places", value=place)
                self._rows.change(schema.services, service_id, place=place, waits_as_proven=proven)


class ProviderEvents:
    """Events about one provider."""

    def __init__(self, providers: Providers, line: Line) -> None:
        self._providers, self._line = providers, line

    def table(self) -> Table:
        change = self._providers.change
        return {
            events.ProviderSuspended: lambda one, _: change(one.provider, suspended=True),
            events.ProviderReinstated: lambda one, _: change(one.provider, suspended=False),
            events.ProviderFellAsleep: lambda one, _: change(one.provider, asleep_until=one.until),
            events.ProviderWokeUp: self._woke_up,
            events.ProviderRests: lambda one, at: change(
                one.provider, rests_until=one.until, bond_locked_until=at.time_s + _BOND_DELAY_S
            ),
            events.ProviderProven: lambda one, _: change(one.provider, earned=True, bond_locked_until=None),
            events.ProviderVouched: self._vouched,
            events.PayoutChanged: lambda one, _: change(
                one.provider, payout=None if one.payout == one.provider else one.payout
            ),
        }

    def _woke_up(self, event: events.ProviderWokeUp, at: At) -> None:
        self._providers.change(event.provider, asleep_until=None)
        if at.woke:
            self._line.offer_all(event.provider)

    def _vouched(self, event: events.ProviderVouched, at: At) -> None:
        """It begins anew if that proves it, or the other way round."""
        before = self._providers.is_proven(event.provider)
        self._providers.change(event.provider, vouched=event.vouched)
        if self._providers.is_proven(event.provider) != before:
            self._providers.change(event.provider, bond_locked_until=None, **AWAKE)
            self._line.offer_all(event.provider)
