"""Which contracts are where: one JSON record per chain, `<data_dir>/deployments/<chain_id>.json`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from eth_typing import ChecksumAddress
from eth_utils import is_checksum_address, to_checksum_address
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from rodeo.bus.origin import record_path
from rodeo.chain import artifacts
from rodeo.chain.node.errors import ChainError, DeploymentMismatch, NotDeployed
from rodeo.host.files import replace_file
from rodeo.money.currency import IEC, Currency

if TYPE_CHECKING:
    from web3 import Web3


class Deployment(BaseModel):
    """An organization's contracts on one chain."""

    # Another release may have written other fields. `verify` compares the contracts.
    model_config = ConfigDict(frozen=True, extra="ignore")

    chain_id: int
    genesis_hash: str
    """Tells a local chain that was reset from the one before: 0x hex."""
    block: int
    """No event of the contracts is in an earlier block."""
    contracts: dict[str, str]
    """Contract name -> checksummed address: `artifacts.CONTRACTS`, `artifacts.GOVERNANCE` if members decide,
    the timelock alone if the administrator's key proposes, and `artifacts.DISPUTES` if verdicts can be
    challenged."""
    decimals: int = IEC.decimals
    """Decimals of the payment token (IECoin among the contracts), as the token itself reports them."""
    is_token_foreign: bool = False
    """The site file names the payment token: it is no IECoin, and was there before."""
    sent: dict[str, int] = {}
    """Checksummed address of each wallet of the site -> transactions that it sent by itself or by the
    deployment step, and not by the bridge. The bridge's journal holds the rest."""
    registry: str | None = None
    """Where the organization was founded (`rodeo.chain.registry`)."""
    rules: tuple[str, ...] = ()
    """Hashes of rules of installed kinds that the deployment step has found or made current. One that is not
    current any more was retired, and stays so."""

    @field_validator("contracts")
    @classmethod
    def _checksummed(cls, contracts: dict[str, str]) -> dict[str, str]:
        if not all(map(is_checksum_address, contracts.values())):
            raise ValueError("not a checksummed address")
        return contracts

    def is_same(self, other: Deployment) -> bool:
        """Whether it is of the same contracts on the same chain."""
        return self.model_copy(update={"sent": other.sent, "rules": other.rules}) == other

    def address(self, contract: str) -> ChecksumAddress:
        return to_checksum_address(self.contracts[contract])

    @property
    def currency(self) -> Currency:
        """What amounts on this chain are of."""
        return Currency(self.decimals)

    @property
    def decides_by_vote(self) -> bool:
        """Whether members decide, and not an administrator."""
        return "MemberVotes" in self.contracts

    @property
    def has_timelock(self) -> bool:
        """Whether the administrator is a timelock: its actions are proposed, and executed after a delay."""
        return "OrganizationTimelock" in self.contracts

    @property
    def has_disputes(self) -> bool:
        """Whether the contracts are there by which verdicts can be challenged."""
        return "DisputeJudge" in self.contracts

    @property
    def committees(self) -> list[str]:
        """The names of those who judge one after the other; the later ones only challenged verdicts."""
        return [name for name in artifacts.COMMITTEES if name in self.contracts]

    @property
    def event_sources(self) -> list[ChecksumAddress]:
        """The contracts whose events hold the organization's state. Where members decide, proposals
        are in the governor's, not the timelock's. Whether a member has a vote is in the organization's
        events. Each committee has seats of its own."""
        others = {"MemberVotes"}
        if self.decides_by_vote:
            others.add("OrganizationTimelock")
        return [self.address(name) for name in self.contracts if name not in others]

    @staticmethod
    def path(data_dir: Path, chain_id: int) -> Path:
        return record_path(data_dir, chain_id)

    @classmethod
    def load(cls, data_dir: Path, chain_id: int) -> Deployment:
        """The record for `chain_id`. Raises NotDeployed when there is none, ChainError when it is damaged."""
        path = cls.path(data_dir, chain_id)
        try:
            return cls.model_validate_json(path.read_bytes())
        except FileNotFoundError as error:
            raise NotDeployed("no contracts on this chain", chain_id=chain_id, path=str(path)) from error
        except (OSError, ValidationError) as error:
            raise ChainError(
                "the deployment record is damaged", path=str(path), problem=str(error)
            ) from error

    def save(self, data_dir: Path) -> Path:
        """Write the record, all of it or nothing; the path."""
        path = self.path(data_dir, self.chain_id)
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, self.model_dump_json(indent=2) + "\n")
        return path

    def verify(self, w3: Web3) -> None:
        """Raises DeploymentMismatch unless the chain has these contracts as they are built now."""
        # Imported here: it imports web3, which only those have who can pass `w3`.
        from rodeo.chain.node.translation import translated

        with translated():
            found = (w3.eth.chain_id, w3.eth.get_block(0)["hash"].to_0x_hex())
            if found != (self.chain_id, self.genesis_hash):
                raise DeploymentMismatch(
                    "another chain",
                    chain_id=found[0],
                    genesis_hash=found[1],
                    recorded_chain_id=self.chain_id,
                    recorded_genesis_hash=self.genesis_hash,
                )
            optional = {*artifacts.GOVERNANCE, *artifacts.DISPUTES}
            expected = {*artifacts.CONTRACTS, *(self.contracts.keys() & optional)}
            if self.contracts.keys() != expected:
                raise DeploymentMismatch(
                    "other contracts", expected=sorted(expected), recorded=sorted(self.contracts)
                )
            for name in self.contracts:
                if name == "IECoin" and self.is_token_foreign:
                    continue
                if not artifacts.load(name).matches(bytes(w3.eth.get_code(self.address(name)))):
                    raise DeploymentMismatch("other code", contract=name, address=self.contracts[name])
