"""The organization over ROS 2, on a closed bus: each node has a certificate of its own."""

from __future__ import annotations

import json
import threading
import uuid
from collections.abc import Callable, Iterator
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
from rodeo.ros2.action import ActionClient, ActionServer, ServerGoal
from rodeo.ros2.errors import GoalAborted, GoalCanceled, GoalRejected, ServiceUnavailable
from rodeo.ros2.node import Node
from rodeo.site import tls
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.dao import PARAMS, Dao, founded
from tests.support.site import free_port, write_site

pytestmark = pytest.mark.long

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
    with founded(path, PROCESS, "ros_dao.berts") as organization:
        robot = Caller(organization, "panther1")
        for name in ("anna-2", "bert"):
            done(robot.call("transfer", to=name, amount_iec="500"))
        robot.close()
        # Who is proven does not rest after it gave a task back.
        organization.command("organization", "vouch", account="bert")
        yield organization


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


def posted(**fields: Any) -> dict[str, Any]:
    """The fields that post a cleaning."""
    params = types.new("rodeo_msgs/msg/TaskParams", json=json.dumps(PARAMS))
    return {"kind": CLEANING, "reward_iec": "10", "params": params, **fields}


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


# -- topics ------------------------------------------------------------------------------------------------


class Heard:
    """The newest message of a latched topic."""

    def __init__(self, caller: Caller, topic: str, typename: str) -> None:
        self.newest: Any = None
        caller.node.subscription(f"{caller.prefix}/{topic}", typename, self._take, wire.LATCHED)

    def _take(self, message: Any, _info: Any) -> None:
        self.newest = message

    def until(self, holds: Callable[[Any], bool]) -> Any:
        return wait_until(lambda: self.newest is not None and holds(self.newest) and self.newest)


def test_who_comes_late_hears_the_tasks_services_and_balances_and_how_they_change(
    dao: Dao, anna: Caller, bert: Caller
) -> None:
    tasks = Heard(anna, "tasks", "rodeo_msgs/msg/Tasks")
    services = Heard(anna, "services", "rodeo_msgs/msg/Services")
    balances = Heard(anna, "balances", "rodeo_msgs/msg/Wallets")
    tasks.until(lambda one: one.total == dao.state("tasks", state="open,assigned")["total"])
    services.until(lambda one: one.total == dao.state("services")["total"])

    def annas(one: Any) -> str:
        return str(next(wallet.balance_iec for wallet in one.wallets if wallet.name == "anna-2"))

    before = float(annas(balances.until(lambda one: True)))
    task_id = done(anna.call("register_task", **posted())).task_id[0]
    tasks.until(lambda one: [task.state for task in one.tasks if task.id == task_id] == ["open"])
    balances.until(lambda one: float(annas(one)) == before - 10)
    done(anna.call("cancel_task", task_id=task_id))
    tasks.until(lambda one: task_id not in [task.id for task in one.tasks])
    balances.until(lambda one: float(annas(one)) == before)


class Log:
    """Every event, as a node reads them: the topic wakes, `get_events` says what happened."""

    def __init__(self, after: int) -> None:
        self.after = after
        self.seen: list[tuple[int, int, int]] = []
        self._lock = threading.Lock()

    def listen(self, caller: Caller) -> None:
        topic = f"{caller.prefix}/events"
        take = partial(self._wake, caller)
        caller.node.subscription(topic, "rodeo_msgs/msg/DaoEvent", take, wire.LATCHED)

    def _wake(self, caller: Caller, _event: Any, _info: Any) -> None:
        with self._lock:
            while True:
                (page,) = caller.call("get_events", after=self.after, limit=np.array([5])).answer
                self.seen += [(one.seq, one.block, one.log_index) for one in page.events]
                if not page.events:
                    return
                self.after = page.events[-1].seq


def test_a_node_that_was_cut_off_misses_no_event_and_counts_none_twice(dao: Dao, bert: Caller) -> None:
    first = dao.state("chain")["last_seq"]
    log = Log(first)

    def pay(times: int) -> None:
        for _ in range(times):
            done(bert.call("transfer", to="carl", amount_iec="0.1"))

    for session in range(3):
        caller = Caller(dao, "anna-2")
        log.listen(caller)
        pay(6)
        if session < 2:
            # It goes at any moment, and others pay while it is away.
            caller.close()
            pay(6)
    last = dao.state("chain")["last_seq"]
    wait_until(lambda: log.after == last)
    caller.close()
    assert [seq for seq, _, _ in log.seen] == list(range(first + 1, last + 1))
    assert len({(block, index) for _, block, index in log.seen}) == last - first >= 30


# -- actions -----------------------------------------------------------------------------------------------

CREATE, DO = "rodeo_msgs/action/CreateTask", "rodeo_msgs/action/DoTask"


def create(caller: Caller) -> ActionClient:
    client = ActionClient(caller.node, f"{caller.prefix}/create_task", CREATE, lost_after_s=HANG_S)
    assert client.wait_for_server(HANG_S)
    return client


def goal(**fields: Any) -> Any:
    return types.new(f"{CREATE}_Goal", **posted(**fields))


class Mind:
    """bert's node: it does what `accept` takes, and its work is the proof."""

    def __init__(self, dao: Dao, caller: Caller, accept: bool = True) -> None:
        self.store_url = dao.site.store_url
        self.goals: list[int] = []
        self.cancelled: list[int] = []
        self.fails = False
        self.work = threading.Event()
        self.work.set()
        self.server = ActionServer(
            caller.node, f"{caller.prefix}/do_task", DO, self._do, lambda asked: self._takes(asked, accept)
        )

    def _takes(self, asked: Any, accept: bool) -> bool:
        self.goals.append(asked.task.id)
        return accept

    def _do(self, handle: ServerGoal) -> None:
        handle.publish_feedback(types.new(f"{DO}_Feedback", activity="cleaning", progress=np.array([0.5])))
        wait_until(lambda: self.work.is_set() or handle.is_cancel_requested)
        if handle.is_cancel_requested:
            self.cancelled.append(handle.request.task.id)
            handle.canceled(types.new(f"{DO}_Result"))
            return
        if self.fails:
            handle.abort(types.new(f"{DO}_Result"))
            return
        digest = f"{handle.request.task.id:064x}"
        uri = f"{self.store_url}/{digest}.mcap"
        handle.succeed(types.new(f"{DO}_Result", proof_sha256=f"0x{digest}", proof_uri=uri))


@pytest.fixture
def service(bert: Caller) -> Iterator[int]:
    """bert's, which anybody may name, and whose tasks have to be accepted."""
    wanted = {"kind": CLEANING, "price_iec": "10", "auto_accept": np.array([False])}
    offered = done(bert.call("register_service", **wanted)).service_id[0]
    done(bert.call("set_namers", service_id=offered, namers=["anybody"]))
    yield int(offered)
    done(bert.call("update_service", service_id=offered, state=["retired"]))


def test_a_goal_posts_a_task_that_anothers_node_does_and_gets_the_result(
    dao: Dao, anna: Caller, bert: Caller, service: int
) -> None:
    mind = Mind(dao, bert)
    mind.work.clear()
    states: list[str] = []
    asked = create(anna).send_goal(
        goal(service_id=np.array([service])), lambda one: states.append(one.task.state), HANG_S
    )
    wait_until(lambda: "assigned" in states)
    mind.work.set()
    wait_until(lambda: "submitted" in states)
    (task_id,) = mind.goals
    dao.judge(task_id, accepted=True)
    result = asked.result(HANG_S)
    (task,) = result.task
    assert (task.id, task.state, task.paid_iec, task.verdict) == (task_id, "settled", "10", ["accepted"])
    assert task.proof_sha256 == [f"0x{task_id:064x}"] and not result.problem
    dao.catch_up()
    told = {event.tx_hash for event in dao.events if event.task_id == task_id}
    assert set(result.transactions) == told and len(result.transactions) == len(told)
    # A ruling that is final at once is seen with the payment.
    order = dict.fromkeys(state for state in states if state != "ruled")
    # Feedback has no place in the result's order: the last of it may come too late to be told.
    assert list(order) in (["assigned", "submitted", "settled"], ["assigned", "submitted"])


def test_a_goal_that_cannot_be_posted_is_aborted_with_the_reason(anna: Caller) -> None:
    for fields, expected in (
        ({"reward_iec": "1000000"}, "insufficient_funds"),
        ({"reward_iec": "much"}, "invalid_request"),
        ({"kind": "flying"}, "unknown_kind"),
    ):
        with pytest.raises(GoalAborted) as caught:
            create(anna).send_goal(goal(**fields), timeout_s=HANG_S).result(HANG_S)
        assert code(caught.value.result) == expected
        assert not len(caught.value.result.task)


def test_goals_run_side_by_side_and_cancelling_one_cancels_its_task(dao: Dao, anna: Caller) -> None:
    client, before = create(anna), dao.balances()["anna-2"]
    ids: list[list[int]] = [[] for _ in range(3)]
    goals = [
        client.send_goal(goal(), lambda one, known=known: known.append(one.task.id), HANG_S) for known in ids
    ]
    wait_until(lambda: all(ids))
    assert dao.balances()["anna-2"] == before - 30
    for asked, (task_id, *_) in zip(goals, ids, strict=True):
        asked.cancel(HANG_S)
        with pytest.raises(GoalCanceled) as caught:
            asked.result(HANG_S)
        assert caught.value.result.task[0].id == task_id
        assert dao.task(task_id)["state"] == "cancelled"
    assert dao.balances()["anna-2"] == before


def test_a_task_that_somebody_has_is_not_cancelled_and_a_goal_without_one_is_not_known(
    dao: Dao, anna: Caller, bert: Caller, service: int
) -> None:
    mind = Mind(dao, bert)
    mind.work.clear()
    client = create(anna)
    asked = client.send_goal(goal(service_id=np.array([service])), timeout_s=HANG_S)
    wait_until(lambda: mind.goals)
    wait_until(lambda: dao.task(mind.goals[0])["accepted"])
    asked.cancel(HANG_S)
    assert not asked.done
    assert not client.knows(bytes(16), HANG_S)
    mind.work.set()
    wait_until(lambda: dao.task(mind.goals[0])["state"] == "submitted")
    dao.judge(mind.goals[0], accepted=True)
    assert asked.result(HANG_S).task[0].state == "settled"


def test_what_a_node_rejects_is_given_back(dao: Dao, anna: Caller, bert: Caller, service: int) -> None:
    mind = Mind(dao, bert, accept=False)
    fields = posted(service_id=np.array([service]), max_attempts=np.array([1]))
    task_id = done(anna.call("register_task", **fields)).task_id[0]
    wait_until(lambda: task_id in mind.goals)
    wait_until(lambda: dao.task(task_id)["state"] == "failed")
    assert dao.task(task_id)["verdict"] == "abandoned" and mind.goals == [task_id]


def test_a_goal_that_is_aborted_gives_the_task_back_and_one_whose_task_is_over_is_cancelled(
    dao: Dao, anna: Caller, bert: Caller, service: int
) -> None:
    mind = Mind(dao, bert)
    mind.work.clear()
    fields = posted(service_id=np.array([service]), max_attempts=np.array([1]))
    task_id = done(anna.call("register_task", **fields)).task_id[0]
    wait_until(lambda: dao.task(task_id)["accepted"])
    done(bert.call("abandon_task", task_id=task_id, attempt=1))
    wait_until(lambda: mind.cancelled == [task_id])
    mind.fails = True
    mind.work.set()
    task_id = done(anna.call("register_task", **fields)).task_id[0]
    wait_until(lambda: dao.task(task_id)["state"] == "failed")
    assert dao.task(task_id)["verdict"] == "abandoned"


def test_after_the_process_was_killed_goals_go_on_and_nothing_is_doubled(
    dao: Dao, anna: Caller, bert: Caller, service: int
) -> None:
    mind = Mind(dao, bert)
    mind.work.clear()
    before, tasks = dao.balances()["anna-2"], dao.state("tasks")["total"]
    client = create(anna)
    asked = client.send_goal(goal(service_id=np.array([service])), timeout_s=HANG_S)
    wait_until(lambda: mind.goals and dao.task(mind.goals[0])["accepted"])
    for process in (PROCESS, "ros_dao.berts"):
        dao.running.kill(process)
    dao.running.start(PROCESS, "ros_dao.berts")
    mind.work.set()
    wait_until(lambda: dao.task(mind.goals[0])["state"] == "submitted")
    dao.judge(mind.goals[0], accepted=True)
    assert asked.result(HANG_S).task[0].state == "settled"
    assert len(mind.goals) == 1 and dao.state("tasks")["total"] == tasks + 1
    assert dao.balances()["anna-2"] == before - 10
    # Its result is on disk.
    dao.running.kill(PROCESS)
    dao.running.start(PROCESS)
    assert client.fetch_result(asked.goal_id).task[0].id == mind.goals[0]
    with pytest.raises(GoalRejected):
        client.send_goal(goal(), timeout_s=HANG_S, goal_id=asked.goal_id)


def test_a_goal_of_another_chain_ends_as_lost(dao: Dao, anna: Caller) -> None:
    client = create(anna)
    known: list[int] = []
    asked = client.send_goal(goal(), lambda one: known.append(one.task.id), HANG_S)
    wait_until(lambda: known)
    dao.running.kill(PROCESS)
    path = dao.site.data_dir / PROCESS / "goals" / "anna-2" / f"{asked.goal_id.hex()}.json"
    record = json.loads(path.read_text())
    path.write_text(json.dumps({**record, "chain": "another"}))
    dao.running.start(PROCESS)
    with pytest.raises(GoalAborted) as caught:
        asked.result(HANG_S)
    assert code(caught.value.result) == "lost"
    done(anna.call("cancel_task", task_id=known[0]))
