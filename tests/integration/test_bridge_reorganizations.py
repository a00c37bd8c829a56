"""A chain that takes blocks back (anvil): the index follows, tells what was undone, and sends ours again."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Iterator
from typing import Any

import pytest
from eth_account import Account

from rodeo_testing.waiting import HANG_S
from services.bridge.index import UNDONE
from tests.integration.test_bridge import assert_index_equals_contracts
from tests.support.dao import Dao, founded
from tests.support.site import write_site

pytestmark = pytest.mark.long

DEV_KEY = "0xac0974bec39a17e36ba4a6b4d238ff944bacb478cbed5efcae784d7bf4f2ff80"
"""First account of the public test mnemonic, which anvil funds."""


@pytest.fixture(scope="module")
def dao(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dao]:
    with founded(write_site(tmp_path_factory.mktemp("reorganizations"), "anvil")) as organization:
        organization.command("panther1", "register_service", kind="waste_disposal", price_iec="100")
        yield organization


def rpc(dao: Dao, method: str, *params: Any) -> Any:
    body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode()
    request = urllib.request.Request(dao.site.chain.url, body, {"content-type": "application/json"})
    with urllib.request.urlopen(request, timeout=HANG_S) as response:
        reply = json.load(response)
    assert "error" not in reply, reply
    return reply["result"]


def approve(dao: Dao, amount: int) -> None:
    """A transaction of a stranger, which nobody will send again."""
    client = dao.client()
    client.send(Account.from_key(DEV_KEY), client.calls.approve(client.organization, amount))


def approvals(dao: Dao) -> list[str]:
    return [event.args["value_iec"] for event in dao.events if event.name == "Approval"]


def undone(dao: Dao) -> list[dict[str, Any]]:
    return [event.args for event in dao.events if event.name == UNDONE]


def assert_every_event_once(dao: Dao) -> None:
    assert [event.seq for event in dao.events] == list(range(1, len(dao.events) + 1))


def test_the_node_tells_of_its_blocks(dao: Dao) -> None:
    assert "polling the node for new blocks" not in dao.running.log("bridge")


def test_what_a_shorter_chain_lacks_is_undone_and_said(dao: Dao) -> None:
    snapshot = rpc(dao, "evm_snapshot")
    approve(dao, 10**18)
    dao.wait_for(lambda: "1" in approvals(dao), "the approval")
    before = len(undone(dao))
    rpc(dao, "evm_revert", snapshot)
    dao.wait_for(lambda: len(undone(dao)) > before, "the notice")
    notice = undone(dao)[-1]
    (event,) = [one for one in dao.events if one.seq == notice["undone_seq"]]
    assert (notice["undone_name"], event.name, event.args["value_iec"]) == ("Approval", "Approval", "1")
    assert_every_event_once(dao)
    assert_index_equals_contracts(dao)


def test_another_chain_of_the_same_length_replaces_what_was_indexed(dao: Dao) -> None:
    approve(dao, 2 * 10**18)
    dao.wait_for(lambda: "2" in approvals(dao), "the approval")
    head = rpc(dao, "eth_blockNumber")
    before = len(undone(dao))
    rpc(dao, "anvil_reorg", 1, [])
    dao.wait_for(lambda: len(undone(dao)) > before, "the notice")
    assert rpc(dao, "eth_blockNumber") == head
    assert undone(dao)[-1]["undone_name"] == "Approval"
    assert_every_event_once(dao)
    assert_index_equals_contracts(dao)


def test_the_bridges_own_transactions_are_mined_again(dao: Dao) -> None:
    snapshot = rpc(dao, "evm_snapshot")
    task_id = dao.post(request_id="posted before the reorganization")
    rpc(dao, "evm_revert", snapshot)
    dao.wait_for(lambda: dao.names_of(task_id).count("TaskAssigned") == 2, "the task again")
    # Another block assigns it: the nonce is another one, and a proof for the first would not count.
    snapshot = rpc(dao, "evm_snapshot")
    sha256 = dao.prove(task_id)
    rpc(dao, "evm_revert", snapshot)
    dao.wait_for(lambda: dao.names_of(task_id).count("ProofSubmitted") == 2, "the proof again")
    assert dao.names_of(task_id) == [
        *("TaskRegistered", "TaskAssigned", UNDONE, UNDONE),
        *("TaskRegistered", "TaskAssigned", "ProofSubmitted", UNDONE, "ProofSubmitted"),
    ]
    assert dao.post(request_id="posted before the reorganization") == task_id
    task = dao.task(task_id)
    assert (task["state"], task["proof_sha256"]) == ("submitted", sha256)
    dao.judge(task_id, accepted=True)
    assert dao.task(task_id)["state"] == "settled"
    assert_every_event_once(dao)
    assert_index_equals_contracts(dao)
