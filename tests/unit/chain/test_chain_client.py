"""The client on both local chains: the money path with typed events, and refusals by name."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal

import pytest
from eth_account import Account

from rodeo.chain.client import ChainClient
from rodeo.chain.contracts.abi import Cause, Fault, Finding, Ruling, ServiceState, TaskRequest, TaskState
from rodeo.chain.contracts.events import (
    ProofSubmitted,
    Reported,
    Ruled,
    ServiceRegistered,
    ServiceUpdated,
    TaskAssigned,
    TaskCancelled,
    TaskRegistered,
    TaskRequeued,
    TaskSettled,
    Transfer,
)
from rodeo.chain.contracts.types import ZERO_ADDRESS, Event, Role
from rodeo.chain.encoding import Call
from rodeo.chain.node.errors import ChainUnavailable, ContractReverted, RpcFailed
from rodeo.money.currency import IEC
from tests.support.organization import KIND, PROOF, REPORT, Organization
from tests.support.site import free_port
from tests.support.views import logs_of, view

PRICE = IEC.to_units(Decimal("79.5"))
REWARD = IEC.to_units(Decimal(100))


@pytest.fixture
def service_id(organization: Organization) -> Iterator[int]:
    """A service of the robot, retired at the end so that the next test's tasks find only their own."""
    (event,) = organization.events(
        organization.robot, organization.client.calls.register_service(KIND, PRICE, 0, True, "collects")
    )
    assert isinstance(event, ServiceRegistered)
    yield event.service_id
    organization.send(
        organization.robot,
        organization.client.calls.update_service(event.service_id, PRICE, ServiceState.RETIRED),
    )


def _refusal(organization: Organization, sender: str, call: Call) -> ContractReverted:
    with pytest.raises(ContractReverted) as refused:
        organization.client.simulate(call, sender)
    return refused.value


def _found(task_id: int, attempt: int, ruling: Ruling, amount: int = 0, reason: str = "") -> Finding:
    return Finding(task_id, attempt, PROOF, REPORT, bytes(32), ruling, Fault.NOBODY, amount, reason)


@pytest.mark.long
def test_a_task_from_registration_to_payment(organization: Organization, service_id: int) -> None:
    client, robot = organization.client, organization.robot.address
    before = {name: client.token.balance(name) for name in (robot, client.organization)}

    registered, assigned = organization.post()
    assert isinstance(registered, TaskRegistered)
    assert isinstance(assigned, TaskAssigned)
    task_id = registered.task_id
    assert registered == TaskRegistered(
        task_id,
        client.organization,
        KIND,
        REWARD,
        3600,
        3600,
        3,
        client.rules.current_rules(KIND)[-1],
        '{"item_id":"item1"}',
    )
    assert (assigned.task_id, assigned.attempt, assigned.executor) == (task_id, 1, robot)
    assert (assigned.service_id, assigned.price) == (service_id, PRICE)
    assert len(assigned.nonce) == 32 and any(assigned.nonce)
    assert client.services.service(service_id).task_id == task_id
    assert client.token.balance(client.task_manager) == REWARD

    (submitted,) = organization.events(
        organization.robot, client.calls.submit_proof(task_id, 1, PROOF, "file:///proof.mcap")
    )
    assert isinstance(submitted, ProofSubmitted)
    assert (submitted.proof_hash, submitted.uri) == (PROOF, "file:///proof.mcap")
    task = client.tasks.task(task_id)
    assert (task.state, task.proof_hash) == (TaskState.SUBMITTED, PROOF)

    reported, ruled, settled = organization.events(
        organization.oracle,
        client.judge_calls.oracle.rule(
            _found(task_id, 1, Ruling.ACCEPTED, PRICE, "all passed"), "file:///report.json"
        ),
    )
    assert reported == Reported(task_id, "file:///report.json", "all passed")
    assert ruled == Ruled(task_id, 1, PROOF, Ruling.ACCEPTED, Fault.NOBODY, PRICE, 0, REPORT)
    assert settled == TaskSettled(task_id, robot, PRICE, REWARD - PRICE)
    task = client.tasks.task(task_id)
    assert (task.state, task.service_id, task.price) == (TaskState.SETTLED, service_id, PRICE)
    assert client.token.balance(robot) == before[robot] + PRICE
    assert client.token.balance(client.organization) == before[client.organization] - PRICE
    assert client.services.service(service_id).completed == 1


def test_a_rejected_attempt_is_requeued_with_its_cause(organization: Organization, service_id: int) -> None:
    client = organization.client
    task_id = _task_id(organization.post())
    organization.send(organization.robot, client.calls.submit_proof(task_id, 1, PROOF, "uri"))
    logged = organization.events(
        organization.oracle,
        client.judge_calls.oracle.rule(_found(task_id, 1, Ruling.REJECTED), ""),
    )
    assert [type(event) for event in logged] == [Reported, Ruled, TaskRequeued, TaskAssigned]
    assert logged[2] == TaskRequeued(task_id, 1, Cause.REJECTED)
    assert client.tasks.task(task_id).attempt == 2
    for attempt in (2, 3):
        organization.send(organization.robot, client.calls.submit_proof(task_id, attempt, PROOF, "uri"))
        organization.send(
            organization.oracle,
            client.judge_calls.oracle.rule(_found(task_id, attempt, Ruling.REJECTED), ""),
        )
    assert client.tasks.task(task_id).state is TaskState.FAILED


def test_the_organization_is_the_creator_of_what_its_operator_posts_and_gets_its_refund(
    organization: Organization,
) -> None:
    client = organization.client
    before = client.token.balance(client.organization)
    task_id = _task_id(organization.post())
    assert client.tasks.task(task_id).creator == client.organization
    number = client.rules.kind(KIND).number
    last = client.services.count()
    assert view(client, "TaskQueues", "oldestOpen", last, number, REWARD) == task_id
    assert view(client, "TaskQueues", "oldestOpen", last, number, REWARD + 10**9) == 0
    logged = organization.events(organization.operator, client.organization_calls.cancel_task(task_id))
    assert logged == [TaskCancelled(task_id, REWARD)]
    assert client.token.balance(client.organization) == before


def test_a_service_is_found_by_price_and_paused(organization: Organization, service_id: int) -> None:
    client = organization.client
    number = client.rules.kind(KIND).number
    assert view(client, "ServiceManager", "bestIdle", number, PRICE, 0, 0) == service_id
    assert view(client, "ServiceManager", "bestIdle", number, PRICE - 10**9, 0, 0) == 0
    logged = organization.events(
        organization.robot, client.calls.update_service(service_id, PRICE, ServiceState.PAUSED)
    )
    assert logged == [ServiceUpdated(service_id, PRICE, ServiceState.PAUSED)]
    assert view(client, "ServiceManager", "bestIdle", number, PRICE, 0, 0) == 0
    assert client.services.service(service_id).state is ServiceState.PAUSED


def test_treasury_and_transfers(organization: Organization) -> None:
    client, robot = organization.client, organization.robot.address
    before = client.token.balance(robot)
    organization.send(organization.operator, client.organization_calls.transfer(robot, 5))
    (log,) = organization.logs(organization.robot, client.calls.transfer(client.organization, 5))
    assert log.event == Transfer(robot, client.organization, 5)
    assert client.token.balance(robot) == before


def test_a_range_of_blocks_gives_the_logs_of_its_receipts_in_order(organization: Organization) -> None:
    client = organization.client
    first = organization.send(
        organization.operator, client.organization_calls.register_task(organization.request())
    )
    posted = logs_of(client, first)
    cancelled = organization.logs(
        organization.operator, client.organization_calls.cancel_task(_task_id([log.event for log in posted]))
    )
    assert client.logs(first["blockNumber"], cancelled[-1].block) == posted + cancelled
    assert client.logs(0, client.w3.eth.block_number)[0].block == client.deployment.block


# -- refusals ----------------------------------------------------------------------------------------------


def test_an_unknown_kind_is_named_as_text(organization: Organization) -> None:
    request = organization.request(kind="painting")
    error = _refusal(
        organization, organization.robot.address, organization.client.calls.register_task(request)
    )
    assert (error.name, error.code, error.details) == ("UnknownKind", "unknown_kind", {"kind": "painting"})


def test_a_wrong_state_comes_with_both_states_by_name(organization: Organization) -> None:
    client = organization.client
    task_id = _task_id(organization.post())
    error = _refusal(organization, organization.robot.address, client.calls.expire_task(task_id))
    assert error.code == "wrong_state"
    assert error.args_by_name == {
        "task_id": task_id,
        "current": TaskState.OPEN,
        "expected": TaskState.ASSIGNED,
    }
    assert error.details == {"task_id": task_id, "current": "open", "expected": "assigned"}
    organization.send(organization.operator, client.organization_calls.cancel_task(task_id))


def test_an_error_from_a_contract_further_down_arrives_as_well(organization: Organization) -> None:
    client, robot = organization.client, organization.robot.address
    balance = client.token.balance(robot)
    request = TaskRequest(KIND, balance + 1, 3600, 3600, 3, bytes(32), 0, ZERO_ADDRESS, "{}")
    error = _refusal(organization, robot, client.calls.register_task(request))
    assert error.code == "erc20_insufficient_balance"
    assert error.args_by_name == {"sender": robot, "balance": balance, "needed": balance + 1}
    assert Decimal(error.details["balance_iec"]) == IEC.from_units(balance)
    assert Decimal(error.details["needed_iec"]) == IEC.from_units(balance + 1)


def test_a_missing_role_is_named(organization: Organization) -> None:
    client, robot = organization.client, organization.robot.address
    call = client.organization_calls.register_task(organization.request())
    error = _refusal(organization, robot, call)
    assert error.code == "access_control_unauthorized_account"
    assert error.details == {"account": robot, "needed_role": Role.OPERATOR.value}


def test_a_refusal_is_raised_before_anything_is_sent(organization: Organization) -> None:
    client = organization.client
    nonce = client.w3.eth.get_transaction_count(organization.robot.address)
    with pytest.raises(ContractReverted) as refused:
        client.send(organization.robot, client.calls.cancel_task(10**6))
    assert (refused.value.name, refused.value.details) == ("UnknownTask", {"task_id": 10**6})
    assert client.w3.eth.get_transaction_count(organization.robot.address) == nonce


def test_views_refuse_by_name_too(organization: Organization) -> None:
    with pytest.raises(ContractReverted) as refused:
        organization.client.devices.device(organization.robot.address)
    assert refused.value.details == {"device": organization.robot.address}


def test_a_wallet_without_gas_money_is_the_nodes_refusal(organization: Organization) -> None:
    client = organization.client
    with pytest.raises(RpcFailed) as refused:
        client.send(Account.create(), client.calls.approve(client.task_manager, 1))
    assert "insufficient" in refused.value.details["reason"].lower()


def test_a_node_that_is_not_there_is_unavailable(organization: Organization) -> None:
    client = ChainClient(f"http://127.0.0.1:{free_port()}", organization.client.deployment)
    with pytest.raises(ChainUnavailable):
        client.tasks.count()


def _task_id(logged: list[Event]) -> int:
    assert isinstance(logged[0], TaskRegistered)
    return logged[0].task_id
