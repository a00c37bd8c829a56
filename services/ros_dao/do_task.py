"""The action `do_task`: each assignment of a participant is offered to its own node, which is a mind.

Nothing of it is on disk. The goal's ID follows from the assignment, so that after a restart the node rejects
what it has already and says that it knows it, and the commands have IDs of their own, too.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from hashlib import sha256
from typing import Any

from rodeo.bus.messages import DaoEvent, Task
from rodeo.dao import Participant
from rodeo.errors import RemoteError, RodeoError
from rodeo.host.clock import WallClock
from rodeo.interfaces.actions import Assigned
from rodeo.interfaces.convert import message
from rodeo.money.currency import Currency
from rodeo.ros2.action import ActionClient, ClientGoal
from rodeo.ros2.errors import ActionServerLost, GoalAborted, GoalCanceled, GoalRejected
from rodeo.ros2.node import Node
from rodeo.site import topics
from services.ros_dao.workers import RETRY_S, mined_in_vain, passes

log = logging.getLogger(__name__)

_LOOK_S = 2.0
"""Wall time between two looks at the assignments without an event, and at one that is being worked on."""
_DECISION_S = 30.0
"""Wall time that a node has to accept or reject a goal; it is asked again after that."""
_MOST_TEXT = 200
"""Characters of what a node says that it does."""
_ACCEPTED = "already_accepted"
"""The contracts' answer to an acceptance that somebody has sent before."""
_MALFORMED = "invalid_request"
"""The answer to a proof that is none, whoever says it."""


class Assignments:
    """Offers the assignments of `participant` in threads of its own.

    Args:
        name: the action's full name.
        say: called with what the node does, and which part of it is done.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        participant: Participant,
        currency: Currency,
        say: Callable[[str, float | None], None],
    ) -> None:
        self._clock = WallClock()
        self._client = ActionClient(node, name, topics.ROS_DO_TASK.type, clock=self._clock)
        self._participant = participant
        self._currency = currency
        self._say = say
        self._news = threading.Event()
        self._stop = threading.Event()
        self._running: set[bytes] = set()
        self._accepted: set[bytes] = set()
        """Goals that the node has accepted since this process began."""
        self._thread = threading.Thread(target=self._run, name=f"do_task {participant.name}", daemon=True)
        self._thread.start()

    def on_event(self, event: DaoEvent) -> None:
        """To be called with each contract event."""
        if event.task_id is not None:
            self._news.set()

    def close(self) -> None:
        self._stop.set()
        self._news.set()
        self._thread.join(timeout=2.0)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._news.wait(_LOOK_S)
            self._news.clear()
            # Without a node that serves the action nothing is asked.
            if self._client.wait_for_server(0.0):
                try:
                    self._offer()
                except RodeoError as error:
                    log.info("cannot see what is assigned: %s", error)
                    self._stop.wait(RETRY_S)
                except Exception:
                    # The thread must outlive one answer: else nothing is offered any more.
                    log.exception("cannot offer what is assigned")
                    self._stop.wait(RETRY_S)

    def _offer(self) -> None:
        name = self._participant.name
        for task in self._participant.tasks(state="assigned", executor=name):
            said = self._participant.assignment(task).model_dump_json()
            goal_id = sha256(said.encode()).digest()[:16]
            if goal_id not in self._running:
                self._running.add(goal_id)
                threading.Thread(
                    target=self._do, args=(task, goal_id), name=f"task {task.id}", daemon=True
                ).start()

    def _do(self, task: Task, goal_id: bytes) -> None:
        try:
            self._carry_out(task, goal_id)
        except RodeoError as error:
            # What is still assigned is offered again.
            log.warning("task %d attempt %d: %s", task.id, task.attempt, error)
            self._stop.wait(RETRY_S)
        except Exception:
            log.exception("task %d attempt %d", task.id, task.attempt)
            self._stop.wait(RETRY_S)
        finally:
            self._running.discard(goal_id)
            self._news.set()

    def _carry_out(self, task: Task, goal_id: bytes) -> None:
        """Raises what the node, the bridge or the contracts say."""
        goal = self._offered(task, goal_id)
        if goal is None:
            self._give_back(task, "the node rejects it")
            return
        # The bond is at stake from the acceptance on: the node itself has to have said that it does the task.
        if goal_id in self._accepted:
            try:
                self._again(task, lambda number: self._participant.accept_task(task, number))
            except RemoteError as error:
                if error.code != _ACCEPTED:
                    goal.cancel()
                    raise
        if self._wait(task, goal):
            try:
                self._hand_in(task, goal)
            except ActionServerLost:
                self._accepted.discard(goal_id)
                raise

    def _offered(self, task: Task, goal_id: bytes) -> ClientGoal | None:
        """The goal, which the node does; None where the node rejects it."""
        if goal_id in self._accepted:
            return self._client.follow(goal_id, self._on_feedback)
        sent = message(Assigned(task=task), self._currency, f"{topics.ROS_DO_TASK.type}_Goal")
        try:
            goal = self._client.send_goal(sent, self._on_feedback, _DECISION_S, goal_id)
        except GoalRejected:
            # A node rejects what it has already.
            known = self._client.knows(goal_id)
            return self._client.follow(goal_id, self._on_feedback) if known else None
        self._accepted.add(goal_id)
        return goal

    def _wait(self, task: Task, goal: ClientGoal) -> bool:
        """Until the node is done: True; False when its attempt is over before, or the process stops."""
        while not goal.wait(self._stop, wall_s=_LOOK_S):
            if self._stop.is_set():
                return False
            if self._over(task):
                log.info("task %d attempt %d is over: its goal is cancelled", task.id, task.attempt)
                goal.cancel()
                return False
        return True

    def _over(self, task: Task) -> bool:
        """Whether this assignment is known to be over."""
        try:
            now = self._participant.task(task.id)
        except RodeoError as error:
            if not passes(error):
                raise
            log.info("cannot see task %d: %s", task.id, error)
            return False
        return (now.state, now.attempt, now.nonce) != ("assigned", task.attempt, task.nonce)

    def _hand_in(self, task: Task, goal: ClientGoal) -> None:
        try:
            result = goal.result(0.0)
            proof = task.id, task.attempt, result.proof_sha256, result.proof_uri, task.nonce
            self._again(task, lambda number: self._participant.submit_proof(*proof, number))
        except (GoalAborted, GoalCanceled) as error:
            self._give_back(task, str(error))
        except RodeoError as error:
            if error.code != _MALFORMED:
                raise
            self._give_back(task, f"the node's result is no proof: {error}")
        else:
            self._say("", None)

    def _give_back(self, task: Task, why: str) -> None:
        log.warning("task %d attempt %d is given back: %s", task.id, task.attempt, why)
        self._say(f"task {task.id} is given back: {why}"[:_MOST_TEXT], None)
        self._again(task, lambda number: self._participant.abandon_task(task, number))

    def _again(self, task: Task, command: Callable[[int], object]) -> None:
        """Send a command until the bridge has carried it out, or the assignment is over. `command` gets the
        number of its transaction. Raises RemoteError where it is refused."""
        number = 1
        while not self._stop.is_set():
            try:
                command(number)
            except RodeoError as error:
                if not passes(error):
                    raise
                number += mined_in_vain(error)
                log.info("trying again: %s", error)
                self._stop.wait(RETRY_S)
                if self._over(task):
                    return
            else:
                return

    def _on_feedback(self, feedback: Any) -> None:
        progress = float(feedback.progress[0]) if len(feedback.progress) else math.nan
        self._say(str(feedback.activity)[:_MOST_TEXT], progress if 0 <= progress <= 1 else None)
