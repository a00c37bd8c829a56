"""Services and their bonds."""

from __future__ import annotations

from typing import Any

from rodeo.chain.contracts import events
from services.bridge import schema
from services.bridge.projection import At, Table
from services.bridge.projection.kinds import Kinds
from services.bridge.projection.providers import Line, Providers
from services.bridge.rows import Rows

_COUNTED = (
    *("completed", "rejected", "expired", "bond", "set_aside", "penalty", "max_failures"),
    *("max_void_percent", "place"),
)
"""Columns of a service that begin at 0."""


class Services:
    """Events about one service."""

    def __init__(self, rows: Rows, providers: Providers, line: Line, kinds: Kinds) -> None:
        self._rows, self._providers, self._line, self._kinds = rows, providers, line, kinds

    def table(self) -> Table:
        change = self._change
        return {
            events.ServiceRegistered: self._registered,
            events.TermsAgreed: lambda one, _: change(
                one.service_id, bond=one.bond, penalty=one.penalty, max_failures=one.max_failures
            ),
            events.PenaltySetAside: self._penalty_set_aside,
            events.PenaltyReturned: self._penalty_returned,
            events.BondPenalized: self._bond_penalized,
            events.BondReturned: self._bond_returned,
            events.ServiceSuspended: lambda one, _: change(one.service_id, state="suspended", place=0),
            events.BondRanShort: lambda one, _: change(one.service_id, state="short", place=0),
            events.ServiceFellAsleep: lambda one, _: change(one.service_id, state="paused", place=0),
            events.ServiceStoodBack: self._stood_back,
            events.NamersChanged: lambda one, _: change(
                one.service_id, namers=one.namers.name.lower(), max_void_percent=one.max_voids
            ),
            events.ServiceReinstated: self._reinstated,
            # One that was changed queues again at the back.
            events.ServiceUpdated: lambda one, _: self._queue_again(
                one.service_id, price=one.price, state=one.state.name.lower()
            ),
            events.ServiceAgreed: lambda one, _: self._queue_again(one.service_id, number=one.kind_id),
        }

    def _change(self, service_id: int, **values: Any) -> None:
        self._rows.change(schema.services, service_id, **values)

    def _queue_again(self, service_id: int, **values: Any) -> None:
        self._change(service_id, **values, place=0)
        self._line.free(service_id)

    def _registered(self, event: events.ServiceRegistered, at: At) -> None:
        self._rows.add(
            schema.services,
            id=event.service_id,
            kind=event.kind,
            number=self._kinds.get(event.kind)["number"],
            provider=event.provider,
            price=event.price,
            state="active",
            description=event.description,
            auto_accept=event.auto_accept,
            namers="proven",
            **dict.fromkeys(_COUNTED, 0),
            waits_as_proven=False,
        )
        self._line.free(event.service_id)
        self._providers.change(event.provider)
        if not self._providers.is_organization(event.provider):  # it has any number
            live = self._providers.get(event.provider)["services"]
            self._providers.change(event.provider, services=[*live, event.service_id])

    def _stood_back(self, event: events.ServiceStoodBack, at: At) -> None:
        self._change(event.service_id, place=0)
        self._line.take(event.service_id)

    def _reinstated(self, event: events.ServiceReinstated, at: At) -> None:
        self._change(event.service_id, state="paused")
        provider = self._rows.get(schema.services, event.service_id)["provider"]
        self._providers.change(provider, failures=0)

    # -- bonds ---------------------------------------------------------------------------------------------

    def _change_bond(self, service_id: int, **by: int) -> None:
        row = self._rows.get(schema.services, service_id)
        self._change(service_id, **{name: row[name] + change for name, change in by.items()})

    def _penalty_set_aside(self, event: events.PenaltySetAside, at: At) -> None:
        self._rows.change(schema.tasks, event.task_id, set_aside=event.amount)
        self._change_bond(event.service_id, bond=-event.amount, set_aside=event.amount)

    def _penalty_returned(self, event: events.PenaltyReturned, at: At) -> None:
        """If its bond covers a penalty again: as ServiceManager.conclude."""
        self._change_bond(event.service_id, bond=event.amount, set_aside=-event.amount)
        service = self._rows.get(schema.services, event.service_id)
        if service["state"] == "short" and service["bond"] >= service["penalty"]:
            owner = service["provider"]
            awake = self._providers.get(owner)["asleep_until"] is None
            self._change(event.service_id, state="active" if awake else "paused")
            if awake and (self._providers.is_proven(owner) or not self._providers.is_engaged(owner)):
                self._line.free(event.service_id)

    def _bond_penalized(self, event: events.BondPenalized, at: At) -> None:
        was_set_aside = bool(self._rows.get(schema.tasks, event.task_id)["set_aside"])
        self._change_bond(event.service_id, **{"set_aside" if was_set_aside else "bond": -event.amount})

    def _bond_returned(self, event: events.BondReturned, at: At) -> None:
        # A retiring service gets its bond back when it is idle, and what was set aside when the case ends.
        service = self._rows.get(schema.services, event.service_id)
        retires = bool(service["bond"]) and service["task_id"] is None
        self._change_bond(event.service_id, **{"bond" if retires else "set_aside": -event.amount})
        self._line.free(event.service_id)
