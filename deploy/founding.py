"""Creates an organization's contracts through the registry of this release, at addresses known beforehand.

Any order of events leaves something to continue from: what is there with the same code and arguments is kept,
and a transaction may be sent again. With the same founder, name and release the addresses are the same on
every chain that has the deterministic deployment proxy.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

from eth_account.signers.local import LocalAccount
from eth_typing import ChecksumAddress, HexStr
from eth_utils import to_checksum_address
from web3 import Web3
from web3.exceptions import BadFunctionCallOutput
from web3.types import Nonce, Wei
from web3.utils import get_create_address

from rodeo.chain import artifacts, registry
from rodeo.chain.contracts.types import ZERO_ADDRESS, Policy, Role
from rodeo.chain.deployment import Deployment
from rodeo.chain.node import transactions
from rodeo.chain.node.errors import ContractReverted, TransactionFailed
from rodeo.chain.node.translation import translated
from rodeo.chain.registry import Part, Registry
from rodeo.errors import ConfigError, RodeoError
from rodeo.host.files import replace_file
from rodeo.signing import keystores
from rodeo.site.config import Site
from rodeo.site.deploying import Steps

log = logging.getLogger(__name__)

MAX_CODE_BYTES = 59_000
"""Most creation code in one transaction: its gas stays below 2^24, more than which no transaction may have
(EIP-7825), with a fifth to spare, and its size below the 128 KiB that geth takes."""

Say = Callable[[str], object]


class OtherToken(RodeoError):
    """The site file names another payment token, or other decimals, than the chain has."""


def create_contracts(
    site: Site,
    w3: Web3,
    founder: LocalAccount,
    say: Say,
    steps: Steps | None = None,
) -> Deployment:
    """All contracts of the site's organization; those that are there already are kept.

    `steps` counts `count_contracts`. Raises ChainError, OtherToken, WalletError, and ConfigError where
    chain.registry is no registry of this release.
    """
    token = existing_token(site, w3)
    steps = steps or Steps()
    names = _names(site, own_token=token is None)
    steps.begin(artifacts.REGISTRY)
    found = ensure_registry(site, w3, founder, say)
    with translated():
        genesis_hash = w3.eth.get_block(0)["hash"].to_0x_hex()
        chain_id = w3.eth.chain_id
    for number in count():
        addresses = found.addresses(founder.address, site.org, number, names)
        if token is not None:
            addresses["IECoin"] = token
        for name, (creator, nonce) in artifacts.CREATED_BY.items():
            addresses[name] = get_create_address(addresses[creator], Nonce(nonce))
        parts = list(_parts(site, founder.address, names, addresses))
        there = {part.name: found.init_code_hash(addresses[part.name]) for part in parts}
        # One founded with another site file keeps its place.
        if all(there[part.name] in (None, part.init_code_hash) for part in parts):
            break
    missing = [part for part in parts if there[part.name] is None]
    if len(missing) < len(parts):
        say(f"{len(parts) - len(missing)} of {len(parts)} contracts are on the chain already")
    blocks: list[int] = []
    steps.plan(len(missing) - len(parts))
    for batch in _batches(missing):
        steps.begin(batch[0].name, len(batch))
        call = found.create(site.org, number, batch)
        receipt = transactions.send(w3, founder, to=call.to, data=call.data)
        blocks.append(receipt["blockNumber"])
        for part in batch:
            say(f"{part.name} at {addresses[part.name]}")
    is_new = len(missing) == len(parts)
    deployment = Deployment(
        chain_id=chain_id,
        genesis_hash=genesis_hash,
        block=blocks[0] if is_new else found.founding_block(founder.address, site.org, number),
        contracts=addresses,
        decimals=site.economy.currency.decimals,
        is_token_foreign=token is not None,
        registry=found.address,
    )
    deployment.verify(w3)
    return deployment


def count_contracts(site: Site) -> int:
    """Number of contracts of an organization, with its registry."""
    return 1 + len(_names(site, own_token=site.economy.token is None))


def ensure_registry(site: Site, w3: Web3, founder: LocalAccount, say: Say) -> Registry:
    """The registry of this release on the site's chain, created if it is not there.

    Raises ConfigError where chain.registry names something else.
    """
    named = site.chain.registry or _remembered(site)
    if named is not None:
        found = Registry(w3, to_checksum_address(named))
        if found.is_there:
            return found
        if site.chain.registry is not None:
            raise ConfigError(
                "chain.registry is no registry of this release: take it out of the site file, and `rodeo "
                "site prepare` puts one on the chain",
                registry=named,
                chain_id=site.chain.id,
            )
    has_proxy = _has_code(w3, registry.PROXY)
    if not has_proxy and site.chain.backend != "external":
        _create_proxy(w3)
        has_proxy = True
    if has_proxy:
        found = Registry(w3, registry.known_address())
        if not found.is_there:
            try:
                transactions.send(w3, founder, to=registry.PROXY, data=registry.creation_data())
            except (ContractReverted, TransactionFailed):
                # It can be put there once, by anybody.
                if not found.is_there:
                    raise
            say(f"{artifacts.REGISTRY} at {found.address}")
        return found
    code = HexStr("0x" + registry.creation_code().hex())
    receipt = transactions.send(w3, founder, data=code)
    address = receipt["contractAddress"]
    assert address is not None
    replace_file(_memory(site), address)
    say(
        f"{artifacts.REGISTRY} at {address}: the chain has no deterministic deployment proxy, so other "
        f'organizations on it have to say `chain.registry = "{address}"`'
    )
    return Registry(w3, address)


def _memory(site: Site) -> Path:
    """File with the address of a registry that this site deployed itself."""
    folder = site.data_dir / "deployments"
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{site.chain.id}.registry"


def _remembered(site: Site) -> str | None:
    try:
        return _memory(site).read_text().strip()
    except FileNotFoundError:
        return None


def _has_code(w3: Web3, address: ChecksumAddress) -> bool:
    with translated():
        return bool(w3.eth.get_code(address))


def _create_proxy(w3: Web3) -> None:
    """On a local chain, whose node has an account with money."""
    with translated():
        rich = w3.eth.accounts[0]
        value = Wei(registry.PROXY_COST_WEI)
        for sent in (
            w3.eth.send_transaction({"from": rich, "to": registry.PROXY_SENDER, "value": value}),
            w3.eth.send_raw_transaction(registry.PROXY_TRANSACTION),
        ):
            w3.eth.wait_for_transaction_receipt(sent, poll_latency=transactions.POLL_S)


def _batches(parts: Sequence[Part]) -> Iterator[list[Part]]:
    """Batches in order, each as large as one transaction may be."""
    batch: list[Part] = []
    for part in parts:
        if batch and sum(len(one.code) for one in (*batch, part)) > MAX_CODE_BYTES:
            yield batch
            batch = []
        batch.append(part)
    if batch:
        yield batch


def _names(site: Site, own_token: bool) -> list[str]:
    """The contracts that the registry creates for the site's organization, in a possible order."""
    governance = site.governance
    wanted = {
        *artifacts.CONTRACTS,
        *(("OrganizationTimelock",) if governance.delay_s else ()),
        *(artifacts.GOVERNANCE if governance.kind == "vote" else ()),
        *(artifacts.DISPUTES if site.disputes is not None else ()),
    }
    if site.disputes is not None and site.disputes.appeal is None:
        wanted.discard(artifacts.COMMITTEES[-1])
    if not own_token:
        wanted.discard("IECoin")
    return [name for name in registry.PARTS if name in wanted]


def _parts(
    site: Site, founder: str, names: Sequence[str], addresses: dict[str, ChecksumAddress]
) -> Iterator[Part]:
    """They name each other, at `addresses`."""
    governance, currency = site.governance, site.economy.currency
    by_vote = governance.kind == "vote"
    coin, organization = addresses["IECoin"], addresses["Organization"]
    services, tasks = addresses["ServiceManager"], addresses["TaskManager"]
    auditors = addresses["AuditorJudge"]
    terms = governance.terms
    arguments: dict[str, tuple[Any, ...]] = {
        "Organization": (
            coin,
            services,
            tasks,
            addresses[Policy.FIRST_COME],
            # From the beginning: a handover takes a later block, and a chain at rest has none.
            addresses.get("OrganizationTimelock", founder),
            governance.delay_s,
            (currency.to_units(terms.bond_iec), currency.to_units(terms.penalty_iec), terms.max_failures),
        ),
        "ServiceManager": (organization, tasks),
        "TaskManager": (organization, services),
        "AuditorJudge": (organization, Role.AUDITOR.id, ZERO_ADDRESS),
        "OracleJudge": (organization, Role.ORACLE.id, auditors),
        **dict.fromkeys((*artifacts.COMMITTEES, "DisputeJudge"), (organization, auditors)),
    }
    if "IECoin" in names:
        arguments["IECoin"] = _first_holders(site, organization, founder)
    if "OrganizationTimelock" in names:
        deciders = [addresses["OrganizationGovernor"]] if by_vote else []
        arguments["OrganizationTimelock"] = (0, [*deciders, founder], by_vote)
    if by_vote:
        arguments |= {
            "MemberVotes": (organization,),
            "BudgetVotes": (organization, addresses["MemberVotes"]),
            "OrganizationGovernor": (
                addresses["MemberVotes"],
                addresses["OrganizationTimelock"],
                governance.voting_period_s,
                governance.quorum_percent,
            ),
        }
    for name in names:
        yield registry.part(name, *arguments.get(name, ()))


def _first_holders(site: Site, organization: str, administrator: str) -> tuple[list[str], list[int]]:
    currency = site.economy.currency
    initial = currency.to_units(site.economy.initial_iec)
    shares = {organization: initial}
    shares |= {keystores.address(site, robot.name): initial for robot in site.robots}
    shares[administrator] = currency.to_units(site.economy.supply_iec) - sum(shares.values())
    return list(shares), list(shares.values())


def existing_token(site: Site, w3: Web3) -> ChecksumAddress | None:
    """The token that the site file names; None for IECoin. Raises OtherToken unless it is there and as the
    file says."""
    token = site.economy.token
    if token is None:
        return None
    address = to_checksum_address(token.address)
    with translated():
        if not w3.eth.get_code(address):
            raise OtherToken("there is no contract at economy.token.address", address=address)
    contract = w3.eth.contract(address=address, abi=artifacts.load("IECoin").abi)
    silent = OtherToken(
        "the contract at economy.token.address does not say how many decimals it has", address=address
    )
    try:
        with translated():
            try:
                decimals = contract.functions.decimals().call()
            except BadFunctionCallOutput as error:
                raise silent from error
    except ContractReverted as error:
        raise silent from error
    if decimals != token.decimals:
        raise OtherToken(
            "the token has other decimals than economy.token.decimals",
            address=address,
            wanted_decimals=token.decimals,
            found_decimals=decimals,
        )
    return address
