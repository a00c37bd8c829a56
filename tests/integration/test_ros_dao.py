"""The organization over ROS 2, on a closed bus: each node has a certificate of its own."""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest
import zenoh

from deploy.certificates import ensure_certificates
from rodeo.bus.session import Bus
from rodeo.host.clock import WallClock
from rodeo.interfaces.package import register
from rodeo.ros2 import definitions, types, wire
from rodeo.ros2.errors import ServiceUnavailable
from rodeo.ros2.node import Node
from rodeo.site import tls
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.dao import PARAMS, Dao
from tests.support.site import RunningSite, free_port, write_site

CLEANING = "waste_disposal"
SITE = """bus.router = "tls/127.0.0.1:{port}"
ros = [
    {{ owner = "annas", participants = ["anna-2", "carl"] }},
    {{ owner = "berts", participants = ["bert", "panther1"] }},
]
[[participants]]
name = "anna-2"
[[participants]]
name = "bert"
kinds = ["waste_disposal"]
[[participants]]
name = "carl"
"""
PROCESS = "ros_dao.annas"


@pytest.fixture(scope="module")
def dao(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Dao]:
    """An organization with two owners, whose participants have some money."""
    register()
    folder = tmp_path_factory.mktemp("ros")
    path = write_site(folder, chain_backend, SITE.format(port=free_port()))
    ensure_certificates(Site.load(path))
    running = RunningSite(path)
    organization = Dao(running)
    try:
        organization.start()
        running.start(PROCESS, "ros_dao.berts")
        robot = Caller(organization, "panther1")
        for name in ("anna-2", "bert"):
            done(robot.call("transfer", to=name, amount_iec="500"))
        robot.close()
        yield organization
    finally:
        organization.stop()
        running.stop()


class Caller:
    """A node of `participant`, with the certificate of `identity`, by default its own."""

    def __init__(self, dao: Dao, participant: str, identity: str | None = None) -> None:
        site = dao.site
        shown = tls.identity(site, identity or f"node.{participant}")
        self._bus = Bus.open(site.bus.router, timeout_s=HANG_S, identity=shown)
        self.prefix = f"lab/{participant.replace('-', '_')}"
        self.node = Node(self._bus.session, "caller", "", site.bus.domain_id, WallClock())

    def call(self, service: str, **fields: Any) -> Any:
        """The response, once there is a server."""
        name = "".join(word.capitalize() for word in service.split("_"))
        typename = f"rodeo_msgs/srv/{name}"
        client = self.node.client(f"{self.prefix}/{service}", typename)
        assert client.wait_for_server(HANG_S)
        return client.call(types.new(f"{typename}_Request", **fields), HANG_S)

    def close(self) -> None:
        self.node.close()
        self._bus.close()


@pytest.fixture
def anna(dao: Dao) -> Iterator[Caller]:
    caller = Caller(dao, "anna-2")
    yield caller
    caller.close()


@pytest.fixture
def bert(dao: Dao) -> Iterator[Caller]:
    caller = Caller(dao, "bert")
    yield caller
    caller.close()


def params(**fields: Any) -> Any:
    return types.new("rodeo_msgs/msg/TaskParams", json=json.dumps(fields))


def done(response: Any) -> Any:
    """What was mined."""
    assert not response.problem, response.problem[0]
    return response.mined[0]


def code(response: Any) -> str:
    (problem,) = response.problem
    assert problem.message and isinstance(json.loads(problem.details), dict)
    return str(problem.code)


def test_a_task_is_posted_done_judged_and_paid(dao: Dao, anna: Caller, bert: Caller) -> None:
    wanted = {"kind": CLEANING, "price_iec": "10", "auto_accept": np.array([False])}
    offered = done(bert.call("register_service", **wanted)).service_id[0]
    done(bert.call("set_namers", service_id=offered, namers=["anybody"]))
    place = types.new("rodeo_msgs/msg/WasteDisposalParams", **PARAMS)
    typed = types.new("rodeo_msgs/msg/TaskParams", waste_disposal=[place])
    post = {"kind": CLEANING, "reward_iec": "10", "params": typed, "service_id": np.array([offered])}
    task_id = done(anna.call("register_task", **post)).task_id[0]
    (task,) = bert.call("get_task", id=task_id).answer
    assert (task.state, task.creator_name, task.executor_name) == ("assigned", ["anna-2"], ["bert"])
    assert task.params.waste_disposal[0].item_id == "item1"
    done(bert.call("accept_task", task_id=task_id, attempt=1))
    digest = "c" * 64
    proof = {"proof_sha256": f"0x{digest}", "proof_uri": f"{dao.site.store_url}/{digest}.mcap"}
    done(bert.call("submit_proof", task_id=task_id, attempt=1, **proof))
    dao.judge(task_id, accepted=True)
    wait_until(lambda: bert.call("get_task", id=task_id).answer[0].state == "settled")
    (listed,) = bert.call("get_tasks", executor=["bert"], limit=np.array([1])).answer
    assert (listed.tasks[0].id, listed.tasks[0].paid_iec, listed.tasks[0].verdict) == (
        task_id,
        "10",
        ["accepted"],
    )
    done(bert.call("update_service", service_id=offered, state=["retired"]))


def test_the_queries_say_what_the_bridge_says(dao: Dao, anna: Caller) -> None:
    (balance,) = anna.call("get_wallet", account=["anna-2"]).answer
    assert balance.balance_wei == str(
        int(float(dao.state("wallet", account="anna-2")["balance_iec"]) * 10**18)
    )
    (services,) = anna.call("get_services", kind=[CLEANING]).answer
    assert services.total == dao.state("services", kind=CLEANING)["total"]
    (rules,) = anna.call("get_organization").answer
    assert CLEANING in [one.kind for one in rules.kinds]
    (people,) = anna.call("get_participants").answer
    assert ["anna-2"] in [one.name for one in people.participants]
    (schema,) = anna.call("get_kind_schema", kind=CLEANING).answer
    assert "item_id" in json.loads(schema.parameters)["properties"]


def test_what_the_organization_refuses_is_an_answer_with_its_code(anna: Caller) -> None:
    assert code(anna.call("get_task", id=10**9)) == "unknown_task"
    assert code(anna.call("transfer", to="bert", amount_iec="1000000")) == "insufficient_funds"
    assert code(anna.call("transfer", to="bert", amount_iec="much")) == "invalid_request"
    assert code(anna.call("get_kind_schema", kind="flying")) == "invalid_request"
    assert code(anna.call("get_tasks", limit=np.array([501]))) == "invalid_request"


def test_a_command_that_is_only_checked_says_its_cost(dao: Dao, anna: Caller) -> None:
    before = dao.balances()
    cost = json.loads(anna.call("transfer", to="bert", amount_iec="1", dry_run=True).cost)
    assert cost["dry_run"] is True and cost["calls"] == ["transfer"]
    assert dao.balances() == before


def test_the_same_request_is_carried_out_once(dao: Dao, anna: Caller) -> None:
    before = dao.balances()["carl"]
    again = [anna.call("transfer", to="carl", amount_iec="1", request_id=["a-name"]) for _ in range(2)]
    assert len({done(one).tx_hash for one in again}) == 1
    others = [anna.call("transfer", to="carl", amount_iec="1") for _ in range(2)]
    assert len({done(one).tx_hash for one in others}) == 2
    assert dao.balances()["carl"] - before == 3


@pytest.mark.parametrize("identity", ["node.bert", "node.carl", "operator", "console", "ros_dao.berts"])
def test_another_certificate_gives_no_commands_of_the_participant(dao: Dao, identity: str) -> None:
    before = dao.balances()["anna-2"]
    intruder = Caller(dao, "anna-2", identity)
    try:
        with pytest.raises(ServiceUnavailable):
            intruder.call("transfer", to="bert", amount_iec="1")
    finally:
        intruder.close()
    assert dao.balances()["anna-2"] == before


@pytest.mark.parametrize("participant", ["nobody", "organization", "anna_2/x"])
def test_a_participant_that_has_no_services_is_not_there(dao: Dao, participant: str) -> None:
    caller = Caller(dao, participant, "node.anna-2")
    typename = "rodeo_msgs/srv/GetChain"
    try:
        client = caller.node.client(f"{caller.prefix}/get_chain", typename)
        with pytest.raises(ServiceUnavailable):
            client.call(types.new(f"{typename}_Request"), HANG_S)
    finally:
        caller.close()


def sent(caller: Caller, key: str, payload: bytes, attachment: bytes) -> dict[str, Any]:
    """The error that answers a request as it is."""
    options: dict[str, Any] = {"target": zenoh.QueryTarget.ALL_COMPLETE, "timeout": HANG_S}
    (reply,) = caller.node.session.get(key, payload=payload, attachment=attachment, **options)
    assert reply.err is not None
    return dict(json.loads(reply.err.payload.to_bytes()))


def test_what_is_no_request_is_refused_by_name_and_holds_up_nothing(anna: Caller) -> None:
    anna.call("get_chain")
    typename = "rodeo_msgs/srv/Transfer"
    key = wire.data_key(0, f"{anna.prefix}/transfer", typename)
    number = wire.Attachment(1, 1, bytes(16)).encode()
    for broken in (b"", b"\0\1\0\0", b"\xff" * 40, types.serialize(types.new(f"{typename}_Request"))[:-9]):
        assert sent(anna, key, broken, number)["code"] == "malformed_message"
    assert sent(anna, key, types.serialize(types.new(f"{typename}_Request")), b"short")["code"] == (
        "malformed_message"
    )
    hash_ = definitions.type_hash(typename)
    other = sent(anna, key.replace(hash_, "RIHS01_" + "0" * 64), b"", number)
    assert other["code"] == "unknown_interface" and other["details"]["served"] == key
    missing = sent(anna, key.replace("transfer", "withdraw"), b"", number)
    assert missing["code"] == "unknown_interface" and "withdraw" in missing["details"]["asked"]
    assert anna.call("get_chain").answer


def test_fifty_clients_at_once_are_all_answered(dao: Dao, anna: Caller, bert: Caller) -> None:
    before = dao.balances()["carl"]
    anna.call("get_chain"), bert.call("get_chain")
    calls = [
        partial((anna, bert)[n % 2].call, *(("get_tasks",) if n % 5 else ("transfer",)),
                **({} if n % 5 else {"to": "carl", "amount_iec": "1"}))
        for n in range(50)
    ]  # fmt: skip
    with ThreadPoolExecutor(50) as clients:
        answers = list(clients.map(lambda call: call(), calls))
    assert not any(one.problem for one in answers)
    assert dao.balances()["carl"] - before == 10


def test_a_command_survives_the_end_of_the_process_and_is_not_doubled(dao: Dao, anna: Caller) -> None:
    before = dao.balances()["carl"]
    said = partial(anna.call, "transfer", to="carl", amount_iec="1", request_id=[uuid.uuid4().hex])
    done(said())
    dao.running.kill(PROCESS)
    dao.running.start(PROCESS)
    done(said())
    assert dao.balances()["carl"] - before == 1


def test_without_a_bridge_the_process_says_so_and_answers_by_name(dao: Dao, anna: Caller) -> None:
    dao.running.kill("bridge")
    status = dao.running.wait_for_status(PROCESS, lambda one: not one.ready)
    assert "the bridge does not answer" in status.reason
    assert code(anna.call("get_chain")) == "no_responder"
    dao.running.start("bridge")
    dao.running.wait_for_status(PROCESS, lambda one: one.ready)
