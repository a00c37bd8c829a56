"""Who is behind an address: the site's participants and their wallets."""

from __future__ import annotations

from eth_utils import is_address, to_checksum_address

from rodeo import wallets
from rodeo.chain import Deployment
from rodeo.config import Site
from services.bridge.errors import UnknownParticipant

ORGANIZATION = "organization"


class Names:
    """Participants by name and by address. The organization's address is its contract's, not its key's."""

    def __init__(self, site: Site, deployment: Deployment) -> None:
        self._addresses: dict[str, str] = {
            name: wallets.address(site, name) for name in wallets.wallet_names(site)
        }
        self._addresses[ORGANIZATION] = deployment.address("Organization")
        self._names = {address: name for name, address in self._addresses.items()}

    @property
    def addresses(self) -> dict[str, str]:
        """Participant -> checksummed address."""
        return dict(self._addresses)

    def name(self, address: str | None) -> str | None:
        """The participant's name; None for a stranger."""
        return None if address is None else self._names.get(address)

    def address(self, who: str) -> str:
        """The address of a participant, or `who` itself where it is one. Raises UnknownParticipant."""
        if who in self._addresses:
            return self._addresses[who]
        if not is_address(who):
            raise UnknownParticipant("no such participant", who=who, known=sorted(self._addresses))
        return to_checksum_address(who)
