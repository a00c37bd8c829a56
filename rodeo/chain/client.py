"""One deployment on one node: what its contracts say, its events, and single transactions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from eth_account.signers.local import LocalAccount
from eth_typing import ChecksumAddress
from eth_utils import to_checksum_address
from web3 import Web3
from web3.types import TxReceipt

from rodeo.chain import views
from rodeo.chain.calls import Calls, JudgeCalls, OrganizationCalls
from rodeo.chain.contract_calls import DeviceRegistryCalls
from rodeo.chain.contracts.logs import Log, decode_logs, event_topics
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call
from rodeo.chain.governance import GovernanceCalls
from rodeo.chain.node import transactions
from rodeo.chain.node.errors import WrongChain
from rodeo.chain.node.rpc import NodeProvider
from rodeo.chain.node.translation import translated
from rodeo.money.currency import Currency
from rodeo.site.sections import ChainConfig

_PAGE_BLOCKS = 2_000
"""Blocks whose events a node is asked for at once."""


def connect(url: str, timeout_s: float = 10.0) -> Web3:
    """A node behind JSON-RPC over HTTP. Nothing is sent yet."""
    # Retrying is the caller's affair: it alone knows whether the answer still matters.
    # Web3's own middleware asks for the chain's id before each call and resolves names of ENS: not needed.
    return Web3(NodeProvider(url, timeout_s), middleware=[])


def require_chain(w3: Web3, config: ChainConfig) -> None:
    """Raises WrongChain unless the node's chain is the one that the site file names, and ChainUnavailable."""
    with translated():
        found = w3.eth.chain_id
    if found != config.id:
        raise WrongChain(
            f"the node at {config.shown_url} is one of chain {found}, and the site's chain is {config.id}: "
            f"see that chain.url of the site file is the site's own node, or say `chain.id = {found}` there",
            node_chain_id=found,
            site_chain_id=config.id,
        )


class ChainClient:
    """The contracts of `deployment` on the node at `url`.

    Every method that asks the node raises ChainUnavailable when it does not answer, ContractReverted when a
    contract refuses and RpcFailed when the node does.
    """

    def __init__(self, url: str, deployment: Deployment) -> None:
        self.w3 = connect(url)
        self.deployment = deployment
        self.calls = Calls(deployment)
        self.organization_calls = OrganizationCalls(deployment)
        self.judge_calls = JudgeCalls(deployment)
        self.device_calls = DeviceRegistryCalls(deployment)
        self.governance_calls = GovernanceCalls(deployment)
        """Where the administrator is a timelock."""
        ask = views.Views(self.w3, deployment)
        self.tasks = views.TaskViews(ask)
        self.services = views.ServiceViews(ask)
        self.devices = views.DeviceViews(ask)
        self.rules = views.RuleViews(ask)
        self.judges = views.JudgeViews(ask)
        self.token = views.TokenViews(ask)
        self.decisions = views.DecisionViews(ask, self.history)

    # -- addresses -----------------------------------------------------------------------------------------

    @property
    def organization(self) -> ChecksumAddress:
        """The organization as a participant: creator and executor of what its operator does."""
        return self.deployment.address("Organization")

    @property
    def task_manager(self) -> ChecksumAddress:
        """Holds the escrow; spender that creators approve."""
        return self.deployment.address("TaskManager")

    @property
    def currency(self) -> Currency:
        return self.deployment.currency

    def time_s(self) -> int:
        """Time of the newest block."""
        with translated():
            return int(self.w3.eth.get_block("latest")["timestamp"])

    # -- events --------------------------------------------------------------------------------------------

    def history(self, sources: Sequence[ChecksumAddress] | None = None) -> Iterator[Log]:
        """All events until now, of `sources` or of `Deployment.event_sources`, in chain order."""
        with translated():
            head = self.w3.eth.block_number
        for first in range(self.deployment.block, head + 1, _PAGE_BLOCKS):
            yield from self.logs(first, min(first + _PAGE_BLOCKS - 1, head), sources)

    def logs(
        self, first_block: int, last_block: int, sources: Sequence[ChecksumAddress] | None = None
    ) -> list[Log]:
        """Events in the inclusive range of blocks, of `sources` or of `Deployment.event_sources`, in chain
        order."""
        with translated(self.currency):
            found = self.w3.eth.get_logs(
                {
                    "fromBlock": first_block,
                    "toBlock": last_block,
                    "address": list(self.deployment.event_sources if sources is None else sources),
                    "topics": [event_topics()],
                }
            )
            return sorted(decode_logs(found), key=lambda log: (log.block, log.log_index))

    # -- transactions --------------------------------------------------------------------------------------

    def simulate(self, call: Call, sender: str) -> bytes:
        """The result that `call` would return now. Raises ContractReverted if it would be refused."""
        with translated(self.currency):
            return bytes(
                self.w3.eth.call({"from": to_checksum_address(sender), "to": call.to, "data": call.data})
            )

    def send(self, account: LocalAccount, call: Call, timeout_s: float = 120.0) -> TxReceipt:
        """Sign, send and wait until mined. One at a time per account: the nonce is read from the node.

        Raises ContractReverted (also before sending), TransactionFailed or TransactionTimeout.
        """
        return transactions.send(
            self.w3, account, to=call.to, data=call.data, timeout_s=timeout_s, currency=self.currency
        )
