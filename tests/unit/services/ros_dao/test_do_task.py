"""A task is accepted on the chain only if the mind has accepted it, and what is no proof gives it back."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rodeo.interfaces.package import register
from rodeo.money.currency import IEC
from rodeo.ros2 import types
from rodeo.ros2.action import ActionServer, ServerGoal
from rodeo.ros2.goals import service_name
from rodeo.ros2.node import Node
from rodeo.ros2.service import DeferredService, PendingRequest
from rodeo.site import topics
from rodeo_testing.waiting import wait_until
from services.ros_dao import do_task
from services.ros_dao.do_task import Assignments
from tests.support.chain_side import FAILED, ChainSide, task

DO, NAME = topics.ROS_DO_TASK.type, "lab/anna/do_task"
DIGEST = "0x" + "c" * 64
MakeNode = Callable[[str], Node]


class Offered:
    """One assignment of anna; a mind is to be added. A command fails as often as `fails` says."""

    def __init__(self, make_node: MakeNode) -> None:
        self.fails: dict[str, int] = {}
        self.said: list[str] = []
        self.dao = ChainSide(self._carry_out)
        self._assign(nonce="0x" + "1" * 64, accepted=False)
        self._server = make_node("dao")
        self.node = make_node("mind")
        self.assignments = self.begin()

    def _assign(self, **fields: Any) -> None:
        self.dao.tasks_by_id[7] = task(
            id=7, attempt=1, executor_name="anna", **{"state": "assigned", **fields}
        )

    def _carry_out(self, name: str, request: Any) -> None:
        if self.fails.get(name, 0) > 0:
            self.fails[name] -= 1
            raise FAILED
        if name != "accept_task":
            self._assign(nonce="0x" + "1" * 64, state="open" if name == "abandon_task" else "submitted")

    def begin(self) -> Assignments:
        return Assignments(self._server, NAME, self.dao, IEC, lambda said, _: self.said.append(said))


@pytest.fixture
def offered(make_node: MakeNode, monkeypatch: pytest.MonkeyPatch) -> Iterator[Offered]:
    register()
    monkeypatch.setattr(do_task, "RETRY_S", 0.05)
    monkeypatch.setattr(do_task, "_LOOK_S", 0.1)
    one = Offered(make_node)
    yield one
    one.assignments.close()


def proof(digest: str = DIGEST) -> Any:
    return types.new(f"{DO}_Result", proof_sha256=digest, proof_uri="http://store/one.mcap")


def names(offered: Offered) -> list[str]:
    return [name for name, _ in offered.dao.sent]


def test_each_command_whose_transaction_failed_is_sent_under_another_number(offered: Offered) -> None:
    offered.fails = {"accept_task": 1, "submit_proof": 2}
    ActionServer(offered.node, NAME, DO, lambda handle: handle.succeed(proof()))
    wait_until(lambda: offered.dao.tasks_by_id[7].state == "submitted")
    accepts, proofs = offered.dao.ids("accept_task"), offered.dao.ids("submit_proof")
    assert accepts == [accepts[0], f"{accepts[0]}-2"]
    assert proofs == [proofs[0], f"{proofs[0]}-2", f"{proofs[0]}-3"] and "c" * 64 in proofs[0]


@pytest.mark.parametrize("digest", ["", "c" * 64])
def test_a_result_that_is_no_proof_gives_the_task_back(offered: Offered, digest: str) -> None:
    ActionServer(offered.node, NAME, DO, lambda handle: handle.succeed(proof(digest)))
    wait_until(lambda: offered.dao.tasks_by_id[7].state == "open")
    assert names(offered) == ["accept_task", "abandon_task"]
    wait_until(lambda: any("is no proof" in said for said in offered.said))


def test_a_mind_that_answers_no_question_about_a_result_accepts_nothing(offered: Offered) -> None:
    """It decides about goals, and what it does not have it does not tell."""
    asked, held = threading.Event(), list[PendingRequest]()

    def reject(pending: PendingRequest) -> None:
        response = types.new(f"{DO}_SendGoal_Response", accepted=False, stamp=types.time_message(0))
        asked.set()
        pending.respond(response)

    DeferredService(offered.node, service_name(NAME, "get_result"), f"{DO}_GetResult", held.append)
    DeferredService(offered.node, service_name(NAME, "send_goal"), f"{DO}_SendGoal", reject)
    wait_until(asked.is_set)
    wait_until(lambda: len(held) > 1)
    assert names(offered) == []


def test_a_mind_that_has_the_goal_of_an_earlier_run_goes_on_and_is_heard(offered: Offered) -> None:
    go = threading.Event()

    def work(handle: ServerGoal) -> None:
        while not go.wait(0.05):
            handle.publish_feedback(types.new(f"{DO}_Feedback", activity="wiping"))
        handle.succeed(proof())

    ActionServer(offered.node, NAME, DO, work)
    wait_until(lambda: "wiping" in offered.said)
    offered.assignments.close()
    offered.said.clear()
    offered.assignments = offered.begin()
    wait_until(lambda: "wiping" in offered.said)
    go.set()
    wait_until(lambda: offered.dao.tasks_by_id[7].state == "submitted")
    assert names(offered) == ["accept_task", "submit_proof"]
