"""Moves a site's organization to new contracts: `rodeo organization migrate`.

Contracts cannot be changed, so an organization moves on by founding another one that follows it. Nothing is
taken out of the old contracts but what they would pay out anyway: no new tasks, the windows of the running
ones end, bonds go back to their providers. Services that nobody retires are suspended. Members, roles, rules
that were set on chain, what providers are known for, and the treasury move. The old contracts stay on chain
as they were.

Each step may be done already: then nothing is done. So it goes on where it was interrupted.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

from eth_account.signers.local import LocalAccount
from eth_utils import to_bytes
from web3 import Web3

from deploy import contracts, waiting
from deploy.founding import create_contracts, token_of
from rodeo import keystores, wallets
from rodeo.chain import events as chain_events
from rodeo.chain.abi import Review, ServiceState, Silence, TaskState
from rodeo.chain.client import ChainClient
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call
from rodeo.chain.errors import ContractReverted, DeploymentMismatch, NotDeployed
from rodeo.chain.governance import Operation, described, text_of
from rodeo.chain.translation import translated
from rodeo.chain.types import Event, Policy, Role
from rodeo.config import Site, bridge_wallets
from rodeo.errors import RodeoError, WalletError
from rodeo.files import replace_file
from rodeo.instance import lock_holder

Say = Callable[[str], object]

_MOST_TOGETHER = 100
"""Members, providers or services in one transaction: each costs some 30,000 gas."""
_NO_TASKS = "The organization moves to new contracts: no new tasks."
_NO_SERVICES = "The organization moves to new contracts: nobody is assigned a task here any more."
_TREASURY = "The organization moves to new contracts, and so does its treasury."
"""What everybody reads where the administrator proposes and waits."""
_RUNNING = (TaskState.ASSIGNED, TaskState.SUBMITTED, TaskState.UNDECIDED)


class TasksRunOn(RodeoError):
    """Tasks of the organization have not ended; they are judged and paid where they were posted."""


class SiteIsUp(RodeoError):
    """The bridge works with the old contracts."""


class NotAdministrator(RodeoError):
    """Only the administrator moves an organization."""


class Founded(RodeoError):
    """The organization that follows is there: from now on there is no way back."""


class JudgeUnseated(RodeoError):
    """The new organization would have somebody judge work who does not judge it in the old one any more."""


class JustMoved(RodeoError):
    """There is nothing to move."""


class KeyRevoked(RodeoError):
    """The new organization would trust a key again that the old one revoked."""


class MembersDecide(RodeoError):
    """Nobody moves an organization whose members decide."""


def migrate(site: Site, w3: Web3, say: Say) -> Deployment:
    """Do what can be done now, and say it. The new organization's record.

    Raises TasksRunOn while there are tasks, SiteIsUp after that while the bridge runs, DelayRuns where the
    administrator waits and what was proposed cannot be done yet, KeyRevoked, JudgeUnseated, MembersDecide,
    NotAdministrator, OtherToken, JustMoved, NotDeployed, ChainError, WalletError, KindError.
    """
    administrator = wallets.load(site, "organization")
    former = _former(site, w3, administrator)
    client = ChainClient(site.chain.url, former)
    happened, judged = _until_now(site, client)
    if waiting.waits(client):
        # What is done last is proposed at the same time, so that the delay passes once for both.
        suspended = _suspensions(client, _others(site, client))
        waiting.propose(client, administrator, [[call] for call in suspended], _NO_SERVICES, say)
    _stop(client, administrator, happened, say)
    _require_none_runs(client)
    if any(lock_holder(site.data_dir / bridge) is not None for bridge in bridge_wallets(site)):
        raise SiteIsUp("all tasks have ended: stop the site with `rodeo down`, then run this command again")
    if waiting.waits(client):
        _withdraw_others(client, administrator, say)
        happened, judged = _until_now(site, client)  # one of them may have been executed a moment before
        _stop(client, administrator, happened, say)
    _retire(site, client, administrator, say)
    _require_none_runs(client)  # one may have been assigned before the last service was suspended
    _cancel(client, administrator, say)
    follower = create_contracts(site, w3, administrator, lambda text: say(f"contracts: {text}"), former)
    contracts.keep_unfinished(site, follower)
    new = ChainClient(site.chain.url, follower)
    _move_rules(site, client, new, administrator, happened, say)
    _move_work(client, new, administrator, happened, say)
    _move_treasury(client, new, administrator, say)
    # After what providers are known for, which nobody moves once there is a task.
    _accept(new, administrator, judged, "in the new organization, too", say)
    done = contracts.set_up(site, w3, follower, administrator, lambda text: say(f"contracts: {text}"))
    _under_way(site, former.chain_id).rename(_kept(site, former))
    _peoples(site, former.chain_id).unlink(missing_ok=True)
    say(f"the organization is at {new.organization} now; the record of the old one is {_kept(site, former)}")
    return done


def cancel(site: Site, say: Say) -> None:
    """Stay, as long as no other organization was founded.

    Raises Founded, NotDeployed where nothing moves, ChainError, WalletError.
    """
    chain_id = site.chain.id
    left = Deployment.load(contracts.left_folder(site), chain_id)
    if contracts.unfinished(site, chain_id) is not None:
        raise Founded("the new organization was founded: finish with `rodeo organization migrate`")
    again = "`rodeo site prepare` lets tasks be posted again"
    client, administrator = ChainClient(site.chain.url, left), wallets.load(site, "organization")
    if not left.has_timelock:
        # Before the site file is asked, which may have oracles judge them.
        _accept(client, administrator, _stopped(site, chain_id), "again", say)
    else:
        waiting.withdraw(client, administrator, (_NO_TASKS, _NO_SERVICES))
        again = "`rodeo organization propose kind` lets tasks be posted again where no more were"
    _under_way(site, left.chain_id).unlink()
    _peoples(site, left.chain_id).unlink(missing_ok=True)
    say(
        f"the organization stays: {again}, and services that were suspended meanwhile can be reinstated with "
        "`rodeo organization reinstate`"
    )


def _under_way(site: Site, chain_id: int) -> Path:
    """The old organization's record, until it is left."""
    return Deployment.path(contracts.left_folder(site), chain_id)


def _peoples(site: Site, chain_id: int) -> Path:
    """What people judge in the old organization, beside its record: once it accepts nothing, no contract says
    so."""
    return _under_way(site, chain_id).with_name(f"{chain_id}-kinds.json")


def _kept(site: Site, former: Deployment) -> Path:
    folder = site.data_dir / "deployments"
    return folder / f"{former.chain_id}-{former.contracts['Organization']}.json"


def _former(site: Site, w3: Web3, administrator: LocalAccount) -> Deployment:
    """The organization to leave: the one that was being left, else the recorded one."""
    if (left := contracts.being_left(site, w3)) is not None:
        return left
    with translated():
        chain_id, genesis_hash = w3.eth.chain_id, w3.eth.get_block(0)["hash"].to_0x_hex()
    # Its code may be that of another release.
    former = Deployment.load(site.data_dir, chain_id)
    if former.genesis_hash != genesis_hash:
        raise NotDeployed("the recorded contracts are on another chain", chain_id=chain_id)
    _require_movable(site, w3, former, administrator)
    _peoples(site, chain_id).unlink(missing_ok=True)
    former.save(contracts.left_folder(site))
    return former


def _require_movable(site: Site, w3: Web3, former: Deployment, administrator: LocalAccount) -> None:
    """Raises MembersDecide, NotAdministrator, OtherToken, and JustMoved: whoever runs the command once too
    often does not want to move again."""
    if former.decides_by_vote or site.governance.kind == "vote":
        raise MembersDecide(
            "the members decide about the organization: propose what its contracts are to be told, and "
            "found another one under another name"
        )
    token_of(former, site)
    client = ChainClient(site.chain.url, former)
    if waiting.waits(client):
        decides = former.address("OrganizationTimelock")
        may = client.may_propose(administrator.address)
    else:
        decides, may = administrator.address, True
    if not (may and client.has_role(Role.ADMINISTRATOR, decides)):
        raise NotAdministrator(
            "the organization's wallet of this site is not its administrator",
            wallet=administrator.address,
            administrator=client.administrator(),
        )
    if former.follows is not None and not client.task_count() and _is_of_this_release(former, w3):
        raise JustMoved(
            "the organization has moved already, and has had no task since", organization=former.follows
        )


def _until_now(site: Site, client: ChainClient) -> tuple[list[Event], dict[str, list[str]]]:
    """What happened in the old organization, and what people judge there (_judged_by_people).

    Raises KeyRevoked and JudgeUnseated.
    """
    happened = [log.event for log in client.history()]
    _require_no_revoked_key(site, happened)
    _require_no_unseated_judge(site, client, happened)
    return happened, _judged_by_people(site, client, happened)


def _require_no_revoked_key(site: Site, happened: list[Event]) -> None:
    """The new organization knows neither of the revocation of a device's key, nor that a judge has another
    key now."""
    # A judge may change its key to any other. One that takes a revoked device's does not make it good again.
    revoked, replaced = set[str](), set[str]()
    for one in happened:
        match one:
            case chain_events.DeviceRevoked():
                revoked.add(one.device)
            case chain_events.JudgeKeyChanged():
                replaced = {*replaced, one.old_key} - {one.key}
            case chain_events.JudgeSeated():
                replaced.discard(one.key)
    used = {keystore: name for keystore, (_, name) in keystores.device_names(site).items()}
    if site.disputes is not None:
        used |= {name: name for one in site.disputes.instances for name in one.judges}
    for keystore, name in used.items():
        address = _address(site, keystore)
        if address in revoked | replaced:
            raise KeyRevoked(
                f"the key of {name} was revoked: put another in its place before the organization moves",
                keystore=keystore,
                address=address,
            )


def _require_no_unseated_judge(site: Site, client: ChainClient, happened: list[Event]) -> None:
    """In the new organization all oracles of the site file judge what any oracle judges."""
    kinds = {one.kind for one in happened if isinstance(one, chain_events.QuorumChanged)}
    judges = {kind: client.quorum(kind).judges for kind in kinds if client.kind(kind).review is Review.ORACLE}
    for oracle in site.oracles:
        key = _address(site, f"{oracle.name}-device")
        judge = None if key is None else client.judge(key)
        for kind in sorted(judges):
            if judge is not None and judges[kind] and not judges[kind] >> judge.seat & 1:
                raise JudgeUnseated(
                    f"{oracle.name} does not judge {kind} any more, and would again: take it out of "
                    "[[oracles]], or let it judge with `rodeo organization quorum`",
                    judge=oracle.name,
                    kind=kind,
                    key=key,
                )


def _address(site: Site, name: str) -> str | None:
    """Of a participant or device; None where its keystore cannot be read: the setup says so, and seats or
    registers nobody with it."""
    try:
        return keystores.wallets_elsewhere(site).get(name) or keystores.address(site, name)
    except WalletError:
        return None


def _is_of_this_release(former: Deployment, w3: Web3) -> bool:
    try:
        former.verify(w3)
    except DeploymentMismatch:
        return False
    return True


def _send(client: ChainClient, administrator: LocalAccount, calls: list[Call]) -> None:
    """Several are all to the organization, as many in one transaction as it may have."""
    for first in range(0, len(calls), _MOST_TOGETHER):
        for call in contracts.at_once(client, calls[first : first + _MOST_TOGETHER]):
            client.send(administrator, call)


def _administer(
    client: ChainClient, administrator: LocalAccount, calls: list[Call], why: str, say: Say
) -> None:
    """Have the administrator do these: at once, or when the delay is over. Raises DelayRuns until then."""
    if waiting.waits(client):
        waiting.perform(client, administrator, [[call] for call in calls], why, say)
        return
    _send(client, administrator, calls)


def _judged_by_people(site: Site, client: ChainClient, happened: list[Event]) -> dict[str, list[str]]:
    """Kinds of work that the organization has accepted since it began to move, and auditors judge -> hashes
    of their rules."""
    chain_id = client.deployment.chain_id
    kinds = _stopped(site, chain_id)
    for kind in sorted({one.kind for one in happened if isinstance(one, chain_events.KindAllowed)}):
        rules = client.kind(kind)
        if rules.allowed and rules.review is Review.AUDITOR:
            kinds[kind] = ["0x" + one.hex() for one in client.current_rules(kind)]
    replace_file(_peoples(site, chain_id), json.dumps(kinds))
    return kinds


def _stopped(site: Site, chain_id: int) -> dict[str, list[str]]:
    """The same as they were known before."""
    path = _peoples(site, chain_id)
    found: dict[str, list[str]] = json.loads(path.read_text()) if path.exists() else {}
    return found


def _stop(client: ChainClient, administrator: LocalAccount, happened: list[Event], say: Say) -> None:
    kinds = {one.kind for one in happened if isinstance(one, chain_events.KindAllowed)}
    allowed = sorted(kind for kind in kinds if client.is_kind_allowed(kind))
    calls = [client.organization_calls.disallow_kind(kind) for kind in allowed]
    _administer(client, administrator, calls, _NO_TASKS, say)
    for kind in allowed:
        say(f"no more tasks of {kind}")


def _withdraw_others(client: ChainClient, administrator: LocalAccount, say: Say) -> None:
    """What else was proposed: anybody could execute it later, and so let a service take a task that waits
    where nobody judges any more."""
    own = {key for why in (_NO_TASKS, _NO_SERVICES, _TREASURY) for key in waiting.proposed(client, why)}
    for key, one in client.pending_operations().items():
        if key not in own:
            client.send(administrator, client.governance_calls.cancel(key))
            say(f"withdrawn, because the organization moves: {text_of(one.targets, one.calldatas)}")


def _require_none_runs(client: ChainClient) -> None:
    """Those that wait for a service do not count: anybody may post one that nobody ever does."""
    tasks = ((number, client.task(number)) for number in range(1, client.task_count() + 1))
    running = {number: task for number, task in tasks if task.state in _RUNNING}
    if running:
        raise TasksRunOn(
            f"{len(running)} tasks have not ended and go on as before: let the site run, and run this "
            "command again later",
            tasks=sorted(running),
            last_deadline_s=max(task.deadline for task in running.values()),
        )


def _cancel(client: ChainClient, administrator: LocalAccount, say: Say) -> None:
    """The organization's own tasks that still wait. Others get their rewards back when they cancel theirs."""
    others = 0
    for number in range(1, client.task_count() + 1):
        task = client.task(number)
        if task.state is not TaskState.OPEN:
            continue
        if task.creator == client.organization:
            client.send(administrator, client.organization_calls.cancel_task(number))
            say(f"task {number}, for which nobody was found, is cancelled")
        else:
            others += 1
    if others:
        say(f"{others} waiting tasks belong to others: cancelling them gives their rewards back at any time")


def _retire(site: Site, client: ChainClient, administrator: LocalAccount, say: Say) -> None:
    """The services of those whose keys are here. Others are suspended: nobody judges here any more what they
    would be assigned. They get their bonds when they retire theirs."""
    here, others = _here(site, client), _others(site, client)
    for number in range(1, client.service_count() + 1):
        service = client.service(number)
        if service.state is ServiceState.RETIRED or service.provider not in here:
            continue
        retire = number, service.price, ServiceState.RETIRED
        if service.provider == client.organization:
            client.send(administrator, client.organization_calls.update_service(*retire))
        else:
            account = wallets.load(site, here[service.provider])
            client.send(account, client.calls.update_service(*retire))
        say(f"service {number} is retired")
    _administer(client, administrator, _suspensions(client, others), _NO_SERVICES, say)
    for number in others:
        say(f"service {number} of somebody else is suspended: retiring it gives its bond back at any time")


def _here(site: Site, client: ChainClient) -> dict[str, str]:
    """Whose services can be retired here: address of a provider -> its name."""
    elsewhere = keystores.wallets_elsewhere(site)
    here = {
        keystores.address(site, name): name for name in keystores.wallet_names(site) if name not in elsewhere
    }
    return {**here, client.organization: "organization"}


def _others(site: Site, client: ChainClient) -> list[int]:
    """Numbers of the services of all others that may still be assigned something."""
    here, over = _here(site, client), (ServiceState.RETIRED, ServiceState.SUSPENDED)
    services = ((number, client.service(number)) for number in range(1, client.service_count() + 1))
    return [number for number, one in services if one.state not in over and one.provider not in here]


def _suspensions(client: ChainClient, services: list[int]) -> list[Call]:
    return [client.organization_calls.suspend_service(number) for number in services]


def _move_rules(
    site: Site,
    client: ChainClient,
    new: ChainClient,
    administrator: LocalAccount,
    happened: list[Event],
    say: Say,
) -> None:
    """What was told the old organization on chain; what the site file says, the new one is told as any is."""
    calls, old = new.organization_calls, client.deployment
    ours = set(old.contracts.values())
    granted = {(one.role, one.account) for one in happened if isinstance(one, chain_events.RoleGranted)}
    wanted: list[Call] = []
    for role, account in sorted(granted):
        if role not in list(Role):
            continue  # that nothing asks for
        name = Role(role)
        if name is Role.ORACLE and site.oracles:
            continue  # nobody who alone judged may beside those who have to agree
        held = name is not Role.ADMINISTRATOR and account not in ours and client.has_role(name, account)
        if held and not new.has_role(name, account):
            admits = name is Role.MEMBER
            wanted.append(calls.admit(account) if admits else calls.grant_role(name, account))
            say(f"{account} is {role} in the new organization")
    suspended = {one.provider for one in happened if isinstance(one, chain_events.ProviderSuspended)}
    for provider in sorted(suspended):
        if client.is_suspended(provider) and not new.is_suspended(provider):
            wanted.append(calls.suspend_provider(provider))
            say(f"{provider} stays suspended")
    if new.terms() != client.terms():
        wanted.append(calls.set_terms(client.terms()))
    if client.members_only() and not new.members_only():
        wanted.append(calls.set_members_only(True))
    for role_ in (Role.OPERATOR, Role.TREASURER):
        budget, there = client.budget(role_), new.budget(role_)
        if budget.since and (budget.amount, budget.period) != (there.amount, there.period):
            wanted.append(calls.set_budget(role_, budget.amount, budget.period))
    for kind in sorted({one.kind for one in happened if isinstance(one, chain_events.KindAllowed)}):
        wanted += _windows(client, new, kind)
    policies = {old.contracts[name]: new.deployment.address(name) for name in Policy if name in old.contracts}
    policy = policies.get(client.policy(), client.policy())
    if policy != new.policy():
        wanted.append(calls.set_policy(policy))
    _send(new, administrator, wanted)


def _windows(client: ChainClient, new: ChainClient, kind: str) -> Iterator[Call]:
    """The bounds of the windows of a kind, and what counts when auditors are silent, as they were set."""
    calls, there, here = new.organization_calls, client.kind(kind), new.kind(kind)
    if there.min_window != here.min_window:
        yield calls.set_min_window(kind, there.min_window)
    bounds = there.min_verdict_window, there.max_verdict_window
    if bounds[1] and bounds != (here.min_verdict_window, here.max_verdict_window):
        yield calls.set_verdict_windows(kind, *bounds)
    audit = there.audit_window, there.silence
    if there.silence is not Silence.NONE and audit != (here.audit_window, here.silence):
        yield calls.set_audit(kind, *audit)


def _move_work(
    client: ChainClient, new: ChainClient, administrator: LocalAccount, happened: list[Event], say: Say
) -> None:
    if new.task_count():
        return  # it was done, or the new organization has begun without it
    providers = sorted(
        {one.provider for one in happened if isinstance(one, chain_events.ServiceRegistered)}
        | {one.provider for one in happened if isinstance(one, chain_events.WorkAdopted)}
    )
    known = [one for one in providers if any(client.work(one)) and client.work(one) != new.work(one)]
    services = client.deployment.address("ServiceManager")
    for first in range(0, len(known), _MOST_TOGETHER):
        some = known[first : first + _MOST_TOGETHER]
        _send(new, administrator, [new.calls.adopt_work(services, some)])
        for provider in some:
            say(f"{provider} is known for its work")


def _accept(
    client: ChainClient, administrator: LocalAccount, judged: dict[str, list[str]], where: str, say: Say
) -> None:
    """What people judge. What oracles judge, the site file says: they need its checks."""
    missing = [kind for kind in judged if not client.is_kind_allowed(kind)]
    hashes = [(kind, one) for kind in missing for one in judged[kind] or ["0x" + "00" * 32]]
    allow = client.organization_calls.allow_kind
    _send(client, administrator, [allow(kind, Review.AUDITOR, to_bytes(hexstr=one)) for kind, one in hashes])
    for kind in missing:
        say(f"people judge {kind} {where}")


def _move_treasury(client: ChainClient, new: ChainClient, administrator: LocalAccount, say: Say) -> None:
    """Straight to the new organization, so that nobody holds it in between."""
    _collect(client, administrator, say)
    amount = client.balance(client.organization)
    if not amount:
        return
    if waiting.waits(client):
        _move_treasury_later(client, new, administrator, say)
        return
    calls, budget = client.organization_calls, client.budget(Role.TREASURER)
    told = [calls.withdraw(new.organization, amount)]
    if budget.period:
        # As it was afterwards: a step that is done again would read it.
        limit = calls.set_budget(Role.TREASURER, budget.amount, budget.period)
        told = [calls.set_budget(Role.TREASURER, 0, 0), *told, limit]
    if not client.has_role(Role.TREASURER, administrator.address):
        told.insert(0, calls.grant_role(Role.TREASURER, administrator.address))
    _send(client, administrator, told)
    say(f"{client.currency.from_units(amount):f} IEC are in the treasury of the new organization")


def _collect(client: ChainClient, administrator: LocalAccount, say: Say) -> None:
    """What the token once refused to the treasury."""
    if not client.pending_payments(client.organization):
        return
    try:
        client.send(administrator, client.calls.withdraw_payments(client.organization))
    except ContractReverted as error:
        say(f"the token still refuses what it owes the old treasury, which can be collected later: {error}")


def _move_treasury_later(
    client: ChainClient, new: ChainClient, administrator: LocalAccount, say: Say
) -> None:
    """What the treasurers' budget lets go goes at once, and more when the delay is over. Raises DelayRuns
    until then. A gift to the treasury meanwhile goes with the budget, and holds up nothing."""
    while balance := client.balance(client.organization):
        operations = waiting.proposed(client, _TREASURY).values()
        amounts = [amount for one in operations if (amount := _withdrawn(client, one)) <= balance]
        if not amounts and _goes_at_once(client, new, administrator, balance):
            moved = balance
        else:
            moved = max(amounts, default=balance)
            batch = _withdrawal(client, new, moved)
            waiting.perform(client, administrator, [batch], _TREASURY, say)
        say(f"{client.currency.from_units(moved):f} IEC are in the treasury of the new organization")


def _goes_at_once(client: ChainClient, new: ChainClient, treasurer: LocalAccount, amount: int) -> bool:
    if not client.has_role(Role.TREASURER, treasurer.address):
        return False
    try:
        client.send(treasurer, client.organization_calls.withdraw(new.organization, amount))
    except ContractReverted as error:
        if error.name != "OverBudget":
            raise
        return False
    return True


def _withdrawal(client: ChainClient, new: ChainClient, amount: int) -> list[Call]:
    """What the timelock does as a treasurer for once, without a limit, which is as before afterwards."""
    calls, budget = client.organization_calls, client.budget(Role.TREASURER)
    timelock = client.deployment.address("OrganizationTimelock")
    told = [calls.withdraw(new.organization, amount)]
    if budget.period:
        limit = calls.set_budget(Role.TREASURER, budget.amount, budget.period)
        told = [calls.set_budget(Role.TREASURER, 0, 0), *told, limit]
    if not client.has_role(Role.TREASURER, timelock):
        roles = calls.grant_role(Role.TREASURER, timelock), calls.revoke_role(Role.TREASURER, timelock)
        told = [roles[0], *told, roles[1]]
    return told


def _withdrawn(client: ChainClient, one: Operation) -> int:
    """How much of the treasury the operation takes, wei."""
    calls = (
        described(client.deployment, target, data)
        for target, data in zip(one.targets, one.calldatas, strict=True)
    )
    return sum(int(call.args["amount"]) for call in calls if call.function == "withdraw")
