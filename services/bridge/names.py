"""The name behind an address: the site's participants and their wallets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from eth_utils import is_address, to_checksum_address

from rodeo.chain import artifacts
from rodeo.chain.contracts.types import ZERO_ADDRESS, Policy
from rodeo.chain.deployment import Deployment
from rodeo.commands.errors import UnknownParticipant
from rodeo.dao import cannot_do, most_offers
from rodeo.signing import keystores
from rodeo.site.config import Site
from rodeo.site.names import oracle_names
from rodeo.text.strict_json import Json

ORGANIZATION = "organization"


class Names:
    """Participants by name and by address. The organization's address is its contract's, not its key's."""

    def __init__(self, site: Site, deployment: Deployment) -> None:
        self._site = site
        self._contracts = deployment.contracts
        keys = {name: keystores.address(site, name) for name in keystores.wallet_names(site)}
        self._keys = {**keys, **keystores.wallets_elsewhere(site)}
        self._addresses = {**self._keys, ORGANIZATION: str(deployment.address("Organization"))}
        self._names = {address: name for name, address in self._addresses.items()}
        self._names_of_keys = {address: name for name, address in self._keys.items()}

    @property
    def addresses(self) -> dict[str, str]:
        """Participant -> checksummed address."""
        return dict(self._addresses)

    @property
    def keys(self) -> dict[str, str]:
        """Participant -> address of the key that signs for it."""
        return dict(self._keys)

    def name(self, address: str | None) -> str | None:
        """The participant's name; None for a stranger."""
        return None if address is None else self._names.get(address)

    def key_name(self, address: str) -> str | None:
        """The owner of this key or contract; None for a stranger's."""
        return self._names_of_keys.get(address) or self._names.get(address)

    def role(self, name: str) -> str:
        """What the participant is on this site."""
        if name == ORGANIZATION:
            return name
        if name in oracle_names(self._site):
            return "oracle"
        return "robot" if name in [robot.name for robot in self._site.robots] else "participant"

    def payout(self, name: str) -> str | None:
        """The account that is paid for a robot's work, if the site file names it."""
        return next((robot.payout for robot in self._site.robots if robot.name == name), None)

    def cannot_do(self, name: str, kind: str) -> str:
        """Why the participant cannot do work of this kind; empty where it can."""
        return cannot_do(self._site, name, kind)

    def most_offers(self, name: str, kind: str) -> int:
        """How many services of this kind the participant may offer at a time."""
        return most_offers(self._site, name, kind)

    def address(self, who: str) -> str:
        """The address of a participant, or `who` itself where it is one. Raises UnknownParticipant."""
        if who in self._addresses:
            return self._addresses[who]
        if not is_address(who):
            raise UnknownParticipant("no such participant", who=who, known=sorted(self._addresses))
        return to_checksum_address(who)

    def key_address(self, who: str) -> str:
        """The key that signs for `who`, which is what holds roles. Raises UnknownParticipant."""
        return self._keys.get(who) or self.address(who)

    def policy(self, address: str) -> str:
        """The policy's name in small letters; its address where it is none of ours."""
        ours = {self._contracts[policy]: policy.name.lower() for policy in Policy}
        return ours.get(address, address)

    def judge_of(self, number: Mapping[str, Any] | None) -> Json:
        """The judge of a kind, and whether it still judges."""
        known = number or {"judge": ZERO_ADDRESS, "removed": False}
        return {"judge": self.judge(known["judge"]), "removed": known["removed"]}

    def judge(self, address: str) -> str:
        """`oracle` for the contracts of oracles, `auditor`, `none`, or the address of another contract."""
        return judge_at(self._contracts, address)


def judge_at(contracts: Mapping[str, str], address: str) -> str:
    """As `Names.judge`."""
    ours = dict.fromkeys(map(contracts.get, artifacts.JUDGES), "oracle")
    return {**ours, contracts["AuditorJudge"]: "auditor", ZERO_ADDRESS: "none"}.get(address, address)
