"""An organization with a bridge's wallets and index, without the bridge's processes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from eth_account.signers.local import LocalAccount

from rodeo.bus.session import Request
from rodeo.chain.encoding import Call
from rodeo.commands.desk import Desk
from rodeo.signing import wallets
from services.bridge.index import Index, Position, TimedLog, sqlite_url
from services.bridge.names import Names
from services.bridge.queries import Queries
from services.bridge.wallet import Wallet, parse
from tests.support.organization import CHAIN_ID, GENESIS_S, Organization


class Office:
    """What is asked of a bridge is checked and built as there, and sent at once."""

    def __init__(self, organization: Organization, folder: Path) -> None:
        self.organization, self.client = organization, organization.client
        self.now_s = GENESIS_S
        deployment = self.client.deployment
        self.index = Index(
            sqlite_url(folder / "index.sqlite"), CHAIN_ID, deployment.genesis_hash, deployment.contracts
        )
        self.names = Names(organization.site, deployment)
        chain: Any = SimpleNamespace(index=self.index, deployment=deployment, node=None)
        self.queries = Queries(chain, self.names, self.client, "", [])

    def account(self, who: str) -> LocalAccount:
        return wallets.load(self.organization.site, who)

    def wallet(self, who: str) -> Wallet:
        unused: Any = SimpleNamespace()
        economy = self.organization.site.economy
        return Wallet(Desk(who, self.client, self.index, self.names, unused, economy, unused), unused)

    def command(self, who: str, name: str, **fields: Any) -> None:
        """Checked and built as the bridge does it, and sent."""
        wallet = self.wallet(who)
        for order in wallet.orders(parse(name, fields)):
            self.send(who, order.call)

    def propose(
        self, command: str, request: dict[str, Any], why: str = "why", who: str = "organization"
    ) -> int:
        self.command(who, "propose", command=command, request=request, description=why)
        return int(self.proposals()[0]["number"])

    def send(self, who: str, call: Call) -> None:
        self.organization.send(self.account(who), call)
        self.read()

    def read(self) -> None:
        """Take in the blocks that the index lacks."""
        eth = self.client.w3.eth
        for number in range(self.index.position.block + 1, eth.block_number + 1):
            block = eth.get_block(number)
            logs = [TimedLog(log, block["timestamp"]) for log in self.client.logs(number, number)]
            self.index.apply(logs, Position(number, block["hash"].to_0x_hex(), block["timestamp"]))

    def proposals(self) -> list[dict[str, Any]]:
        return list(self.queries.answer("proposals", Request("state/proposals", {}, {}))["proposals"])

    def state(self, number: int) -> str:
        return str(next(one["state"] for one in self.proposals() if one["number"] == number))
