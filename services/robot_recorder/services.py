"""The recorder's ROS 2 services. What is refused is an answer, too."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import Any

import zenoh

from rodeo.bus.session import validate
from rodeo.errors import RodeoError
from rodeo.host.clock import Clock
from rodeo.host.clocked import act
from rodeo.interfaces.convert import problem, request_of
from rodeo.interfaces.package import Interface, recorder
from rodeo.interfaces.recorder import Present, StartRecording, StopRecording
from rodeo.money.currency import IEC
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.ros2.service import DeferredService, PendingRequest
from rodeo.site import topics
from services.robot_recorder.errors import StillWorking
from services.robot_recorder.showing import Showing
from services.robot_recorder.takes import Takes

log = logging.getLogger(__name__)

Answer = Callable[[Any], dict[str, Any]]
"""The fields of a response, from the model of the request."""

MOST_ASKING = 16
"""Requests that hear what comes of one work: a client that lost patience asks again."""


class HeldService:
    """One service, which works on one request at a time, in a thread of its own. From a request's arrival to
    its answer the site's clock is held, but for the waits on it: the mind that asks cannot hold it.

    A request that arrives during the work does not hold the clock, or the work could wait for a clock that
    waits for the work. The same request gets the answer of the work; any other is refused at once.
    """

    def __init__(self, node: Node, name: str, interface: Interface, clock: Clock, answer: Answer) -> None:
        self._interface, self._clock, self._answer = interface, clock, answer
        self._response = f"{interface.typename}_Response"
        types.prepare(f"{interface.typename}_Request")
        types.prepare(self._response)
        self._lock = threading.Lock()
        self._asking: list[PendingRequest] = []
        """Those that hear what comes of the work under way; the first began it."""
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._service = DeferredService(node, name, interface.typename, self._take)
        node.keep(self)

    def _take(self, pending: PendingRequest) -> None:
        with self._lock:
            begins = not self._asking
            same = begins or pending.request == self._asking[0].request
            if heard := same and len(self._asking) < MOST_ASKING:
                self._asking.append(pending)
        if begins:
            self._begin(pending)
        elif not heard:
            busy = StillWorking(f"{self._interface.name} is at work on another request: ask again")
            self._answer_to([pending], {"problem": [problem(busy)]})

    def _begin(self, pending: PendingRequest) -> None:
        # The thread may have ended: a client of a process that stops hears that nobody answers.
        with suppress(RuntimeError):
            act(self._clock, partial(self._work, pending), self._thread.submit)

    def _work(self, pending: PendingRequest) -> None:
        fields = self._fields(pending)
        with self._lock:
            asking, self._asking = self._asking, []
        self._answer_to(asking, fields)

    def _answer_to(self, asking: list[PendingRequest], fields: dict[str, Any]) -> None:
        response = types.new(self._response, **fields)
        for one in asking:
            try:
                one.respond(response)
            except zenoh.ZError as error:
                log.info("did not answer, because this process is leaving the bus: %s", error)

    def _fields(self, pending: PendingRequest) -> dict[str, Any]:
        try:
            said = request_of(self._interface.parts[0], pending.request, IEC)
            return self._answer(validate(self._interface.models[0], said))
        except RodeoError as error:
            log.warning("refused %s: %s", self._interface.name, error)
            return {"problem": [problem(error)]}
        except Exception as error:
            log.exception("%s failed", self._interface.name)
            return {"problem": [problem(RodeoError(f"internal error: {error!r}"))]}

    def close(self) -> None:
        self._service.close()
        self._thread.shutdown(wait=False, cancel_futures=True)


def serve(node: Node, namespace: str, takes: Takes, showing: Showing, clock: Clock) -> None:
    """Serve what the mind of the robot in `namespace` asks for, until `node` is closed."""

    def start(asked: StartRecording) -> dict[str, Any]:
        take = takes.start(asked.task_id, asked.attempt)
        return {"recording": take.recording.claimant.recording, "resumed": take.resumed}

    def present(asked: Present) -> dict[str, Any]:
        said = showing.present(asked.bin, asked.grasped)
        return {
            "item_class": said.item_class,
            "compartment": said.compartment,
            "full": said.full,
            "another_angle": said.another_angle,
        }

    def stop(asked: StopRecording) -> dict[str, Any]:
        proof = takes.stop(asked.task_id, asked.attempt, asked.failure)
        return {"proof_uri": proof.uri, "proof_sha256": proof.sha256, "missing": proof.missing}

    answers: dict[topics.Topic, Answer] = {
        topics.START_RECORDING: start,
        topics.PRESENT: present,
        topics.STOP_RECORDING: stop,
    }
    for topic, answer in answers.items():
        HeldService(node, topic.name(ns=namespace), recorder()[topic.key], clock, answer)
