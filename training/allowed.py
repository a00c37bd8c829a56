"""The people whose word about a bin counts, as the organization's index tells it.

Whoever can write into a bin's folder can put corrections there that any key signed. So the running site is
asked who its auditors are, and which keys are registered as its bins'.

    RodeoError
    └── SiteSilent            the site does not run, or nobody there answers
"""

from __future__ import annotations

from dataclasses import dataclass

from rodeo.bus import queries
from rodeo.bus.messages import Device
from rodeo.bus.origin import check_bus
from rodeo.bus.session import Bus
from rodeo.errors import BusUnavailable, NoResponder, QueryTimeout, RodeoError
from rodeo.site.config import Site
from rodeo.site.tls import OPERATOR, identity
from rodeo.witness.statement import Scope

_ANSWER_S = 10.0


class SiteSilent(RodeoError):
    """Nobody says who may correct."""


@dataclass(frozen=True)
class Allowed:
    """Auditors that may say what an item was, and keys that speak for bins."""

    scope: Scope
    """The organization, on its chain."""
    auditors: frozenset[str]
    """Lower-case addresses of those who hold the role now. What others signed teaches nothing, former
    auditors included: they may have lost the role for it."""
    keys: tuple[Device, ...]
    """All that were ever registered."""

    @classmethod
    def at(cls, site: Site) -> Allowed:
        """Ask the site's bridge, which must run. Raises SiteSilent, BusError, RemoteError."""
        try:
            with Bus.open(site.bus.router, timeout_s=_ANSWER_S, identity=identity(site, OPERATOR)) as bus:
                check_bus(bus, site)
                chain = queries.ask(bus, site.org, queries.CHAIN)
                roles = queries.ask(bus, site.org, queries.ORGANIZATION).roles
                devices = queries.ask(bus, site.org, queries.DEVICES).devices
        except (BusUnavailable, NoResponder, QueryTimeout) as error:
            raise SiteSilent(
                "the site must run, it says who may correct its bins: start it with `rodeo up`",
                org=site.org,
                reason=str(error),
            ) from error
        return cls(
            scope=Scope(
                chain_id=chain.chain_id,
                task_manager=chain.contracts.task_manager,
                organization=chain.contracts.organization,
            ),
            auditors=frozenset(one.address.lower() for one in roles.get("AUDITOR_ROLE", [])),
            keys=tuple(devices),
        )

    def speaks_for(self, address: str, bin_name: str, time_s: float) -> bool:
        """Whether a key was the bin's at that site time. One that was compromised never was: whoever has it
        can sign for any time."""
        return any(
            key.address.lower() == address.lower()
            and (key.role, key.name) == ("bin", bin_name)
            and key.revoked_because != "compromised"
            and (key.registered or 0.0) <= time_s
            and (key.revoked is None or time_s <= key.revoked)
            for key in self.keys
        )
