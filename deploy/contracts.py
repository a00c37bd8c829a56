"""Put the organization's contracts on the site's chain: `python -m deploy.contracts --site FILE`.

Idempotent, and it continues where it was interrupted: contracts that are there are kept (unless the chain was
reset, or a local chain's were built from other sources), and so is every rule that already holds. Of the
fixed supply of `economy.supply_iec`, the organization and each robot get `economy.initial_iec`; the rest goes
to the organization's administrator, who brings it in with Organization.deposit when the treasury needs it.

On an external chain the wallets must hold gas already; on a local one the node's first account gives it.
`rodeo site prepare` does this and all that it needs, and prints each step.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

from eth_account.signers.local import LocalAccount
from eth_utils import to_bytes, to_checksum_address
from web3 import Web3

from deploy.founding import OtherToken, count_contracts, create_contracts
from deploy.gas_money import fund
from rodeo.chain import artifacts
from rodeo.chain.client import ChainClient, connect, require_chain
from rodeo.chain.contracts.abi import Instance, KindRules, Windows
from rodeo.chain.contracts.events import ProviderVouched, RoleRevoked
from rodeo.chain.contracts.types import MAX_RULES, ZERO_ADDRESS, Role
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call
from rodeo.chain.node.errors import ChainUnavailable, ContractReverted, DeploymentMismatch, NotDeployed
from rodeo.chain.node.translation import translated
from rodeo.errors import RodeoError, WalletError
from rodeo.judging import votes
from rodeo.kinds import VERDICT_WINDOWS_S, Kind, kinds_of
from rodeo.runtime.process import main
from rodeo.signing import keystores, possession, wallets
from rodeo.site.config import Site
from rodeo.site.deploying import Steps, deploying
from rodeo.site.names import ORACLE, min_verdict_window_s, panel, votes_needed

log = logging.getLogger(__name__)

NODE_S = {"external": 15.0, "anvil": 3600.0, "eth-tester": 3600.0}
"""Wall time to wait for the node to answer. A local one is about to start, which may take a slow
machine long; its launcher reports when it cannot."""
_RETRY_S = 0.1
_UNLIMITED = 2**256 - 1
_MOST_TOGETHER = 60
"""Calls in one transaction: a device's registration, the most expensive of them, takes 120,000 gas."""
_PAYMENTS = frozenset({"approve", "depositStake"})
"""Calls that the founder sends itself even where the timelock administers: the tokens are the founder's."""
_ANSWERS_S = 60.0
"""The embedded node works for seconds on the transaction that founds an organization, and longer on a busy
machine."""
"""The contracts' default for the longest verdict window."""


class OtherGovernance(RodeoError):
    """Another governance decides on chain than the site file names, and this step changes neither."""


class MemberTwice(RodeoError):
    """Two names under governance.members are one account, which has one vote."""


class OtherRelease(RodeoError):
    """The site's organization has contracts of another release. Whoever runs the site decides whether another
    organization is founded: nothing of the old one, such as its treasury or its tasks, goes over to it."""


class WithoutDisputes(RodeoError):
    """The contracts by which rulings are challenged are not on chain, and this step does not add them."""


class WithoutJudges(RodeoError):
    """Judges that the site file names have no seat, because their keys are not here."""


class WithoutGasMoney(RodeoError):
    """Wallets that have to send transactions hold nothing to pay for them."""


Say = Callable[[str], object]
"""Gets a sentence for each step."""


class _Sender:
    """Sends what sets the organization up.

    Where the administrator is a timelock, it is so from the beginning, and does at once what its founder
    schedules, until the founder ends that. Later changes of the site file have to be proposed.
    """

    def __init__(self, client: ChainClient, administrator: str, names: dict[str, str], say: Say) -> None:
        self._client, self._names, self._say = client, names, say
        self._administrator = administrator
        self._by_timelock = client.deployment.has_timelock
        self.is_founding = self._by_timelock and client.decisions.delay_s() == 0
        self._waiting: list[Call] = []
        """Calls of the administrator to the organization."""
        self.sent: Counter[str] = Counter()
        """Address -> transactions."""

    def send(self, account: LocalAccount, call: Call) -> None:
        """At once, but for what the administrator sends to the organization: that waits for what follows."""
        if account.address != self._administrator:
            self._send(account, call)
        elif call.name in _PAYMENTS:
            # It may be for a judge that was seated before.
            self.flush(account)
            self._send(account, call)
        elif self._by_timelock and not self.is_founding:
            self._say(f"{call.name} of the site file is not on chain: it takes {self._way}")
            return
        elif call.to == self._client.organization:
            if len(self._waiting) == _MOST_TOGETHER:
                self.flush(account)
            self._waiting.append(call)
            return
        else:
            # It may be about what was sent before.
            self.flush(account)
            self._administer(account, [call])
        self._say(f"{call.name} sent by {self._names[account.address]}")

    def flush(self, administrator: LocalAccount) -> None:
        """Send what waits, in one transaction."""
        waiting, self._waiting = self._waiting, []
        if waiting:
            self._administer(administrator, waiting)
            told = Counter(call.name for call in waiting)
            calls = ", ".join(name if times == 1 else f"{times} {name}" for name, times in told.items())
            self._say(f"{calls} sent by {self._names[administrator.address]}")

    def end_founding(self, founder: LocalAccount, delay_s: int) -> None:
        """From now on nothing that an administrator may do happens without the delay."""
        for left in self._client.decisions.pending():
            # Of an attempt that was interrupted: otherwise anybody could have it done again at any time.
            self._send(founder, self._client.governance_calls.cancel(left))
        self._waiting += self._client.governance_calls.end_founding(founder.address, delay_s)
        self.flush(founder)
        self.is_founding = False
        decides = "the members decide by vote" if self._by_vote else "the administrator's key proposes"
        self._say(f"from now on {decides}, with a delay of {delay_s} s")

    @property
    def _by_vote(self) -> bool:
        return self._client.deployment.decides_by_vote

    @property
    def _way(self) -> str:
        """The way in which a founded organization is changed."""
        return "a vote of the members" if self._by_vote else "a proposal of the administrator"

    def _administer(self, administrator: LocalAccount, calls: Sequence[Call]) -> None:
        for call in _at_once(self._client, calls):
            self._send(administrator, call)

    def _send(self, account: LocalAccount, call: Call) -> None:
        self._client.send(account, call)
        self.sent[account.address] += 1


def _at_once(client: ChainClient, calls: Sequence[Call]) -> Sequence[Call]:
    """Transactions of the administrator's key that make the organization execute `calls`: several are all to
    its own contract. Where a timelock is the administrator, that works until the founding ends."""
    if client.deployment.has_timelock:
        return client.governance_calls.found(calls, os.urandom(32))
    if len(calls) < 2:
        return calls
    return [client.organization_calls.multicall([to_bytes(hexstr=call.data) for call in calls])]


def run(site: Site, stop: threading.Event, say: Say = log.info) -> None:
    """Deploy what is missing; running it again after an error continues from there.

    Raises ChainError, KindError, WalletError, OtherRelease or WithoutGasMoney; WrongChain before anything is
    sent there.
    """
    kinds_of(site)  # what nobody can judge is refused before anything is deployed
    with deploying(site, stop) as steps:
        _deploy(site, stop, say, steps)


def _deploy(site: Site, stop: threading.Event, say: Say, steps: Steps) -> None:
    local = site.chain.backend != "external"
    if local:
        wallets.ensure_wallets(site)
    w3 = connect(site.chain.url, _ANSWERS_S) if local else connect(site.chain.url)
    if not wait_for_node(site, w3, stop, say):
        return
    require_chain(w3, site.chain)
    names = {address: name for name in keystores.wallet_names(site) if (address := _told(site, name))}
    steps.plan(count_contracts(site) + 1 + local)
    if local:
        steps.begin("gas money for the wallets")
        fund(w3, list(names))
    administrator = wallets.load(site, "organization")
    deployment = _recorded(site, w3)
    if deployment is None:
        _require_gas_money(site, w3)
        first_members(site)
        deployment = create_contracts(site, w3, administrator, say, steps)
        # For this step alone, until the organization is set up.
        deployment.save(unfinished(site))
    else:
        steps.plan(-count_contracts(site))
    found = "vote" if deployment.decides_by_vote else "administrator"
    if found != site.governance.kind:
        raise OtherGovernance(
            "the contracts on this chain were deployed with another kind under [governance]: set that in the "
            "site file, or deploy for a new organization",
            wanted=site.governance.kind,
            found=found,
        )
    _require_token(site, deployment)
    if site.disputes is not None and len(deployment.committees) <= len(site.disputes.instances):
        table = "[disputes.appeal]" if deployment.has_disputes else "[disputes]"
        raise WithoutDisputes(
            f"the contracts on this chain were deployed without {table}: take that table out, or deploy "
            "for a new organization"
        )
    steps.begin("roles, kinds of work and devices")
    set_up(site, w3, deployment, administrator, say)


def set_up(site: Site, w3: Web3, deployment: Deployment, administrator: LocalAccount, say: Say) -> Deployment:
    """Send the organization what the site file has and the chain lacks, and record it.

    Raises ChainError, KindError and WalletError.
    """
    names = {address: name for name in keystores.wallet_names(site) if (address := _told(site, name))}
    client = ChainClient(site.chain.url, deployment)
    sender = _Sender(client, administrator.address, names, say)
    for account, call in _missing_rules(site, client, administrator, deployment.rules):
        sender.send(account, call)
    if sender.is_founding:
        _require_judges(site, client)
        for call in _missing_members(site, client):
            sender.send(administrator, call)
        sender.end_founding(administrator, site.governance.delay_s)
    else:
        sender.flush(administrator)
        if (told := _other_delay(site, client)) is not None:
            say(told)
    # Only now, so that whoever finds the record finds an organization that works.
    deployment = deployment.model_copy(
        update={
            "sent": _sent(site, w3, deployment, sender.sent),
            "rules": _known_rules(site, client, deployment),
        }
    )
    path = deployment.save(site.data_dir)
    Deployment.path(unfinished(site), deployment.chain_id).unlink(missing_ok=True)
    say(f"contracts on chain {deployment.chain_id} since block {deployment.block}: {path}")
    return deployment


def wait_for_node(site: Site, w3: Web3, stop: threading.Event, say: Say) -> bool:
    """Wait until the site's node answers; False when stopped before. Raises ChainUnavailable."""
    url, wait_s = site.chain.shown_url, NODE_S[site.chain.backend]
    deadline_s = time.monotonic() + wait_s
    said = False
    while not stop.is_set():
        try:
            with translated():
                return w3.eth.chain_id > 0
        except ChainUnavailable as error:
            if time.monotonic() > deadline_s:
                remedy = _REMEDY[site.chain.backend == "external"]
                raise ChainUnavailable(f"no node answered at {url} for {wait_s:.0f} s: {remedy}") from error
            if not said:
                say(f"waiting for the node at {url}, {wait_s:.0f} s at most")
                said = True
            stop.wait(_RETRY_S)
    return False


_REMEDY = {
    True: "start it, or correct `chain.url` in the site file",
    False: "start the site with `rodeo up`, or only prepare it with `rodeo site prepare`",
}
"""By whether the chain is elsewhere."""


def _told(site: Site, name: str) -> str | None:
    """The address of a keystore; None where that cannot be read, which need not keep all others waiting."""
    try:
        return keystores.address(site, name)
    except WalletError as error:
        log.error(
            "skipped %s, whose roles on chain stay unchanged: %s; repair its keystore and run this step "
            "again",
            name,
            error,
        )
        return None


def _possession(site: Site, client: ChainClient, keystore: str, owner: str) -> tuple[bytes, bytes] | None:
    """Signature by which the device key agrees to its owner; None where the keystore cannot be opened."""
    try:
        key = keystores.open_key(site, keystore)
    except WalletError as error:
        log.error(
            "skipped %s, which is not registered: %s; run this step again with its key", keystore, error
        )
        return None
    nonce, registry = client.devices.nonce(key.address), client.deployment.address("DeviceRegistry")
    signed = bytes.fromhex(possession.sign(key, owner, nonce, client.w3.eth.chain_id, registry)[2:])
    return signed[:32], signed[32:]


def recorded(site: Site, w3: Web3) -> bool:
    """Whether the contracts are on the node's chain already. Raises ChainUnavailable and OtherRelease."""
    return _recorded(site, w3) is not None


def _require_gas_money(site: Site, w3: Web3) -> None:
    accounts = {name: keystores.address(site, name) for name in keystores.sender_names(site)}
    with translated():
        empty = {
            name: account
            for name, account in accounts.items()
            if not w3.eth.get_balance(to_checksum_address(account))
        }
    if empty:
        raise WithoutGasMoney("these wallets need the chain's native currency to pay for gas", **empty)


def _require_token(site: Site, deployment: Deployment) -> None:
    """Raises OtherToken unless the contracts pay with what the site file says."""
    token = site.economy.token
    wanted = None if token is None else token.address, site.economy.currency.decimals
    found = deployment.address("IECoin") if deployment.is_token_foreign else None, deployment.decimals
    if wanted != found:
        raise OtherToken(
            "the contracts on this chain pay with another token than economy.token of the site file: correct "
            "that, or deploy for a new organization",
            wanted=wanted[0] or "IECoin",
            wanted_decimals=wanted[1],
            found=found[0] or "IECoin",
            found_decimals=found[1],
        )


def unfinished(site: Site) -> Path:
    """Folder of the record until the organization is set up."""
    return site.data_dir / "deployments" / "unfinished"


def _recorded(site: Site, w3: Web3) -> Deployment | None:
    """The deployment to keep, finished or not. None where there is none, or the chain was reset, or a local
    chain, whose money is nobody's, has contracts of another release. Raises OtherRelease elsewhere."""
    with translated():
        chain_id, genesis_hash = w3.eth.chain_id, w3.eth.get_block(0)["hash"].to_0x_hex()
    for folder in (site.data_dir, unfinished(site)):
        try:
            deployment = Deployment.load(folder, chain_id)
            deployment.verify(w3)
        except NotDeployed:
            continue
        except DeploymentMismatch as mismatch:
            if site.chain.backend == "external" and deployment.genesis_hash == genesis_hash:
                raise OtherRelease(
                    "the organization's contracts are of another release, and this one works with its own "
                    "only: continue with the software of that release, or move the record away and run "
                    "`rodeo site prepare`, which founds a new organization",
                    organization=deployment.contracts["Organization"],
                    record=str(Deployment.path(folder, chain_id)),
                ) from mismatch
            log.warning("deploying again: %s", mismatch)
            continue
        return deployment
    return None


def _sent(site: Site, w3: Web3, deployment: Deployment, now: Counter[str]) -> dict[str, int]:
    """Transactions that wallets sent without the bridge: all while no bridge has a record, then those of this
    step (`now`)."""
    found = dict(deployment.sent)
    with translated():
        for name in keystores.wallet_names(site):
            address = to_checksum_address(keystores.address(site, name))
            if address in found:
                found[address] += now[address]
            else:
                found[address] = w3.eth.get_transaction_count(address)
    return found


def _roles(site: Site, client: ChainClient, administrator: str) -> list[tuple[Role, str | None]]:
    """Accounts that get a role at first; None where one is not known."""
    roles = [
        (Role.OPERATOR, administrator),
        (Role.TREASURER, administrator),
        (Role.ORACLE, None if site.oracles else _told(site, ORACLE)),
        (Role.AUDITOR, administrator),
    ]
    if client.deployment.has_timelock:
        # So that proposals set the prices of the organization's services.
        roles.append((Role.OPERATOR, client.deployment.address("OrganizationTimelock")))
    if client.deployment.decides_by_vote:
        # It pays what members have split, and nothing else.
        roles.append((Role.ALLOCATOR, client.deployment.address("BudgetVotes")))
    guardian = site.governance.guardian
    elsewhere = keystores.wallets_elsewhere(site)
    told = None if guardian is None else elsewhere.get(guardian) or _told(site, guardian)
    return [*roles, (Role.GUARDIAN, told)]


def _missing_devices(site: Site, client: ChainClient) -> Iterator[Call]:
    for keystore, (device_role, name) in keystores.device_names(site).items():
        device = _told(site, keystore)
        if device is not None and not _is_registered(client, device):
            owner = _owner(site, client, device_role, name)
            if signature := _possession(site, client, keystore, owner):
                yield client.organization_calls.register_device(device, device_role, owner, name, *signature)


def _missing_rules(
    site: Site, client: ChainClient, administrator: LocalAccount, known: Sequence[str]
) -> Iterator[tuple[LocalAccount, Call]]:
    """Calls, with their senders, that are missing until the organization is as in the site file. `known` are
    hashes that were current before."""
    calls = client.organization_calls
    if (former := _former_oracle(site, client)) is not None:
        yield administrator, calls.revoke_role(Role.ORACLE, former)
    roles = _roles(site, client, administrator.address)
    for role, account in _roles_to_grant(client, roles):
        yield administrator, calls.grant_role(role, account)
    for spenders, limit in site.governance.budgets.items():
        limited = Role[spenders.upper()]
        # Never set: what the administrator changed later stays.
        if client.rules.budget(limited).since == 0:
            amount = site.economy.currency.to_units(limit.iec)
            yield administrator, calls.set_budget(limited, amount, limit.period_s)
    if client.judges.auditors() == ZERO_ADDRESS:
        yield administrator, calls.set_auditors(client.deployment.address("AuditorJudge"))
    for kind in kinds_of(site).values():
        for call in _missing_kind(site, client, administrator.address, kind, known):
            yield administrator, call
    for call in _missing_devices(site, client):
        yield administrator, call
    for account in _unproven(site, client):
        yield administrator, calls.vouch_for(account, True)
    for robot in site.robots:
        wallet = _told(site, robot.name)
        if wallet is not None and client.token.allowance(wallet, client.task_manager) < _UNLIMITED // 2:
            spender = wallets.load(site, robot.name)
            yield spender, client.calls.approve(client.task_manager, _UNLIMITED)


def _unproven(site: Site, client: ChainClient) -> list[str]:
    """The site's own robots for which nobody vouches. Other participants prove themselves by their work. Once
    somebody has ended it on chain, it stays so."""
    robots = [account for robot in site.robots if (account := _told(site, robot.name)) is not None]
    missing = [account for account in robots if not client.services.is_proven(account)]
    if not missing:
        return []
    happened = (log.event for log in client.history([client.deployment.address("Providers")]))
    ended = {one.provider for one in happened if isinstance(one, ProviderVouched) and not one.vouched}
    return [account for account in missing if account not in ended]


def _other_delay(site: Site, client: ChainClient) -> str | None:
    """Hint if the organization was founded with another delay than the site file's."""
    wanted_s = site.governance.delay_s
    if not client.deployment.has_timelock:
        if not wanted_s:
            return None
        return (
            "the administrator's key acts at once in this organization, which was founded so: "
            "governance.delay_s of the site file counts for another organization"
        )
    if (there_s := client.decisions.delay_s()) == wanted_s:
        return None
    return (
        f"governance.delay_s of the site file is {wanted_s} and not {there_s} as on chain: `rodeo "
        "organization propose delay` changes it"
    )


def _require_judges(site: Site, client: ChainClient) -> None:
    """Raises WithoutJudges unless somebody judges every kind. Once the organization is founded a seat takes a
    proposal, and until then an organization without judges could do nothing."""
    missing = [name for name, kind in kinds_of(site).items() if not _has_judges(site, client, kind)]
    if missing:
        raise WithoutJudges(
            "judges of these kinds have no seat, because their keys are not here: run this step again with "
            "their keystores, or with their keys in the environment",
            kinds=missing,
            variables=f"{keystores.KEY_VARIABLE}NAME",
        )


def first_members(site: Site) -> list[str]:
    """Their accounts. Raises MemberTwice."""
    elsewhere = keystores.wallets_elsewhere(site)
    names = {(elsewhere.get(name) or keystores.address(site, name)): name for name in site.governance.members}
    if len(names) < len(site.governance.members):
        raise MemberTwice("two of governance.members are one account: name others", **names)
    return list(names)


def _missing_members(site: Site, client: ChainClient) -> Iterator[Call]:
    """Calls that give the first members their votes."""
    for account in first_members(site):
        if not client.rules.is_member(account):
            yield client.organization_calls.grant_role(Role.MEMBER, account)
        if not client.decisions.votes(account):
            yield client.governance_calls.votes.sync(account)


def _roles_to_grant(
    client: ChainClient, roles: Sequence[tuple[Role, str | None]]
) -> Iterator[tuple[Role, str]]:
    """Missing roles. A role that was revoked on chain stays revoked: it may have been stolen."""
    missing = [
        (role, account)
        for role, account in roles
        if account is not None and not client.rules.has_role(role, account)
    ]
    if not missing:
        return
    happened = (log.event for log in client.history([client.organization]))
    revoked = {(one.role, one.account) for one in happened if isinstance(one, RoleRevoked)}
    for role, account in missing:
        # The organization's own contracts have no key. The site file decides which of them judges.
        if (role, account) not in revoked or account in client.deployment.contracts.values():
            yield role, account
            continue
        log.warning(
            "%s of %s was revoked on chain, and stays so: `rodeo organization grant` gives it back",
            *(role, account),
        )


def _former_oracle(site: Site, client: ChainClient) -> str | None:
    """The account that judges alone on chain, and by the site file no longer does."""
    if not site.oracles or not keystores.keystore_path(site, ORACLE).exists():
        return None
    oracle = _told(site, ORACLE)
    return oracle if oracle is not None and client.rules.has_role(Role.ORACLE, oracle) else None


def _missing_kind(
    site: Site, client: ChainClient, administrator: str, declared: Kind, known: Sequence[str]
) -> Iterator[Call]:
    """Calls that have work of this kind judged by the judge in the site file. A judge that is not one of the
    organization's own contracts, or the auditors in place of a machine, were named on chain, and stay."""
    kind, calls, rules = declared.name, client.organization_calls, client.rules.kind(declared.name)
    wanted = judge_of(site, declared)
    judge, there = client.deployment.address(wanted), _judge_there(client, rules)
    if rules.allowed and there != judge:
        machines = {client.deployment.contracts.get(one) for one in artifacts.JUDGES} - {
            client.deployment.address("AuditorJudge")
        }
        if there not in machines:
            log.warning(
                "%s judges %s on chain, and the %s in the site file: `rodeo organization kind %s --judge` "
                "changes that",
                there,
                kind,
                wanted,
                kind,
            )
            return
        log.warning(
            "another judge, the %s, decides about %s: whoever offers such a service has to agree to it",
            wanted,
            kind,
        )
    if not rules.max_window:
        price = site.economy.currency.to_units(declared.reference_price_iec)
        yield calls.set_windows(kind, _first_windows(site, declared), price)
    if declared.judge == "auditor":
        if not rules.allowed or there != judge:
            yield calls.allow_kind(kind, judge, bytes(32))
        return
    # The contracts refuse a judge that has no terms.
    if site.oracles:
        yield from _missing_judges(site, client, kind)
    if site.disputes is not None:
        yield from _missing_instances(site, client, administrator, kind)
    if _has_judges(site, client, declared):
        known_ = known if there == judge and rules.allowed else None
        yield from _missing_hash(client, declared, judge, known_)


def _first_windows(site: Site, declared: Kind) -> Windows:
    """The windows with which a kind begins. What is on chain stays."""
    windows = Windows(*declared.windows_s, declared.grace_period_s, *VERDICT_WINDOWS_S, 0)
    if declared.judge == "auditor":
        return windows
    windows = replace(windows, audit_window=site.economy.audit_window_s)
    return windows if site.disputes is None else _with_room(site, windows)


def _with_room(site: Site, windows: Windows) -> Windows:
    """The same, but the verdict window leaves time for every challenge that the site file allows."""
    longest_s = max(windows.max_verdict_window, site.economy.verdict_window_s)
    return replace(windows, min_verdict_window=min_verdict_window_s(site), max_verdict_window=longest_s)


def judge_of(site: Site, declared: Kind) -> str:
    """The contract that judges work of this kind, as the site file says: one of `artifacts.JUDGES`."""
    if declared.judge == "auditor":
        return "AuditorJudge"
    if site.disputes is not None:
        return "DisputeJudge"
    return "OracleCommittee" if site.oracles else "OracleJudge"


def _has_judges(site: Site, client: ChainClient, kind: Kind) -> bool:
    """Whether the judge of this kind could say its terms: its seats are taken, and its instances known."""
    if kind.judge == "auditor" or not site.oracles:
        return True
    return client.judges.quorum(kind.name).votes > 0 and (
        site.disputes is None or bool(client.judges.instances(kind.name))
    )


def _judge_there(client: ChainClient, rules: KindRules) -> str | None:
    """The judge on chain; None for a kind that never had one."""
    return client.judges.numbered(rules.number) if rules.number else None


def _missing_judges(site: Site, client: ChainClient, kind: str) -> Iterator[Call]:
    """Calls that have the site's oracles vote on proofs of `kind`. A quorum that is on chain stays: the
    administrator or the members may have changed it."""
    quorum, needed = client.judges.quorum(kind), votes_needed(site, kind)
    if quorum.votes:
        if (quorum.votes, quorum.count) != (needed, len(site.oracles)):
            log.warning(
                "%d of %d oracles judge %s on chain, and %d of %d in the site file: `rodeo organization "
                "seat`, `unseat` and `quorum` change those on chain",
                quorum.votes,
                quorum.count,
                kind,
                needed,
                len(site.oracles),
            )
        return
    keys = {f"{one.name}-device": _owner(site, client, "oracle", one.name) for one in site.oracles}
    committee = artifacts.COMMITTEES[0]
    yield from _seated(site, client, committee, kind, keys, (needed, panel(site), site.oracle.rotation_s))


def _seated(
    site: Site,
    client: ChainClient,
    committee: str,
    kind: str,
    keys: Mapping[str, str | None],
    quorum: tuple[int, int, int],
) -> Iterator[Call]:
    """Calls that seat these judges, keystore -> owner (None: the key itself), and has them vote on proofs of
    `kind` by this quorum: votes, panel, rotation. No quorum where one of them cannot be seated yet."""
    seats, calls = 0, client.judge_calls.committee(committee)
    for keystore, named in keys.items():
        key = keystores.wallets_elsewhere(site).get(keystore) or _told(site, keystore)
        if key is None:
            return
        if client.judges.seat(key, committee) is None:
            owner = named or key
            if (signed := _agreed(site, client, committee, keystore, owner)) is None:
                return
            yield calls.seat(key, owner, *signed)
        seated = client.judges.seat(key, committee)
        if seated is None:
            return  # where others decide, it waits for them
        seats |= 1 << seated.number
    votes_, panel_, rotation_s = quorum
    yield calls.set_quorum(kind, votes_, panel_, rotation_s, seats)


def _agreed(
    site: Site, client: ChainClient, committee: str, keystore: str, owner: str
) -> tuple[bytes, bytes] | None:
    """Signature by which a judge's key agrees to its seat; None where the keystore cannot be opened."""
    address = client.deployment.address(committee)
    try:
        return votes.possession(keystores.open_key(site, keystore), owner, client.w3.eth.chain_id, address)
    except WalletError as error:
        log.error(
            "skipped %s, which has no seat in the %s at %s: %s; run this step again with its key",
            keystore,
            committee,
            address,
            error,
        )
        return None


def _missing_instances(site: Site, client: ChainClient, administrator: str, kind: str) -> Iterator[Call]:
    """Calls that let rulings on `kind` be challenged. An instance on chain stays, as a quorum does."""
    wanted = site.disputes
    if wanted is None or client.judges.instances(kind) or not client.judges.quorum(kind).votes:
        return
    committees = client.deployment.committees[: 1 + len(wanted.instances)]
    for committee, one in zip(committees[1:], wanted.instances, strict=True):
        keys = dict.fromkeys(one.judges)
        yield from _seated(site, client, committee, kind, keys, (one.votes, len(keys), 0))
        if not client.judges.quorum(kind, committee).votes:
            return
    rules = client.rules.kind(kind)
    if rules.max_window and rules.min_verdict_window < min_verdict_window_s(site):
        now = Windows(**{one.name: getattr(rules, one.name) for one in fields(Windows)})
        price = client.rules.reference_price(kind)
        yield client.organization_calls.set_windows(kind, _with_room(site, now), price)
    to_units = site.economy.currency.to_units
    if not any(client.judges.instances(one) for one in kinds_of(site)):
        # Later on a stake that is too low was lost or withdrawn.
        staked = zip(committees, wanted.instances, strict=False)
        needed = {committee: to_units(one.judge_stake_iec) for committee, one in staked}
        yield from _missing_stakes(client, administrator, kind, needed)
    # How an instance's ruling is challenged before the next one, and how long that takes.
    challenged = [
        (one.window_s, to_units(one.stake_iec), to_units(one.judge_stake_iec)) for one in wanted.instances
    ]
    decisions = [0, *(one.decision_s for one in wanted.instances)]
    yield client.judge_calls.dispute.set_instances(
        kind,
        [
            Instance(client.deployment.address(committee), window_s, decision_s, stake, judge_stake)
            for committee, decision_s, (window_s, stake, judge_stake) in zip(
                committees, decisions, [*challenged, (0, 0, 0)], strict=True
            )
        ],
    )


def _missing_stakes(
    client: ChainClient, administrator: str, kind: str, wanted: Mapping[str, int]
) -> Iterator[Call]:
    """Stakes that the administrator deposits for judges of `kind` (`wanted`: for each of a committee); none
    where its tokens do not suffice."""
    disputes = client.deployment.address("DisputeJudge")
    missing = {
        (committee, seat): stake - there
        for committee, stake in wanted.items()
        for seat in range(64)
        if client.judges.quorum(kind, committee).seats >> seat & 1
        and (there := client.judges.stake(seat, committee)) < stake
    }
    needed = sum(missing.values())
    if needed > (balance := client.token.balance(administrator)):
        log.warning(
            "the stakes of %d judges take %s IEC, of which the organization's wallet has %s: their votes "
            "count once `rodeo organization deposit-stake` has deposited them",
            len(missing),
            client.currency.text(needed),
            client.currency.text(balance),
        )
        return
    if client.token.allowance(administrator, disputes) < needed:
        yield client.calls.approve(disputes, needed)
    for (committee, seat), amount in missing.items():
        yield client.judge_calls.dispute.deposit_stake(client.deployment.address(committee), seat, amount)


def _missing_hash(client: ChainClient, kind: Kind, judge: str, known: Sequence[str] | None) -> Iterator[Call]:
    """Calls that let tasks of `kind` be posted under the installed rules, which the site's oracle has, and be
    judged by `judge`. Those that were current stay so, as far as there is room: their tasks are judged by
    them. Installed rules among the `known` ones that are not current were retired by somebody, and stay so.
    None for `known`: the kind is not allowed with this judge, which has no rules yet."""
    # Imported here: what the checks use takes its time.
    from rodeo.checks.rules import rules_hash

    calls, current, installed = (
        client.organization_calls,
        client.rules.current_rules(kind.name),
        rules_hash(kind),
    )
    digest = bytes.fromhex((installed or "").removeprefix("0x"))
    if known is not None:
        if digest in current:
            return
        if installed in known:
            log.warning(
                "the installed rules %s of %s were retired and stay so: install the rules that are current, "
                "or make these current again with `rodeo organization kind %s --judge oracle`",
                installed,
                kind.name,
                kind.name,
            )
            return
        if len(current) == MAX_RULES:
            yield calls.retire_rules(kind.name, current[0])
    yield calls.allow_kind(kind.name, judge, digest)


def _known_rules(site: Site, client: ChainClient, deployment: Deployment) -> tuple[str, ...]:
    """Rules that were known, and the installed ones that are current now."""
    from rodeo.checks.rules import rules_hash

    current = {"0x" + one.hex() for kind in kinds_of(site) for one in client.rules.current_rules(kind)}
    installed = {rules_hash(kind) for kind in kinds_of(site).values()}
    return tuple(sorted({*deployment.rules, *(current & installed)}))


def _is_registered(client: ChainClient, device: str) -> bool:
    try:
        client.devices.device(device)
    except ContractReverted as error:
        if error.name != "UnknownDevice":
            raise
        return False
    return True


def _owner(site: Site, client: ChainClient, device_role: str, name: str) -> str:
    """A robot's device works for the robot, an oracle's for the owner in the site file or for itself, and
    everything else for the organization."""
    if device_role == "oracle":
        owner = next(one.owner for one in site.oracles if one.name == name) or name
        return keystores.wallets_elsewhere(site).get(owner) or keystores.address(site, owner)
    return keystores.address(site, name) if device_role == "robot" else client.organization


if __name__ == "__main__":
    sys.exit(main("contracts", run, "Deploy the organization's contracts on the site's chain."))
