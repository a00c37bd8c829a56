"""One delivery from its order to its sealed recording: the contactor moves, the robot is asked to sign."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from hashlib import file_digest
from pathlib import Path

from pydantic import ValidationError

from rodeo.bus.messages import Task
from rodeo.charging.orders import ChargingParams
from rodeo.errors import NoResponder, QueryTimeout, RemoteError, RodeoError
from rodeo.evidence.errors import RecordingSealed
from rodeo.evidence.seal import Binding
from rodeo.host.clocked import ClockedEvent
from rodeo.lab.config import DockConfig
from rodeo.recording.door import stamp_slack_s
from rodeo.recording.seals import SealPublisher
from rodeo.recording.statements import StatementDoor, StatementListener
from rodeo.runtime.process import Process
from rodeo.signing.keys import Signer
from rodeo.signing.keystores import SiteDevice
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness.chain import WitnessChain
from rodeo.witness.statement import Scope
from rodeo.witness.witness import Witness
from services.charger.delivery import Delivery, Order
from services.charger.feed import Feed
from services.charger.job import Job, require_payable, wrong_order
from services.charger.retries import RETRY_S, Retries
from services.charger.session import End, Phase, SessionLimits
from services.charger.terminals import Terminals

log = logging.getLogger(__name__)

PROOF_SHARE = 0.05
"""Share of the execution window that is kept for sealing and submitting."""
CLOSING_WALL_S = 15.0
"""Wall time for which the robot is asked to sign the end. Earlier receipts count without."""
NOBODY = "nobody"
"""In place of a robot that the site does not have: nothing is received from it, whatever its name."""
_CHAIN_WALL_S = 0.1


@dataclass(frozen=True)
class Hands:
    """The dock's parts that a delivery uses.

    `stands` asks the index whether an assignment still stands, and `save` stores a job. `wake` is set when
    something happened on the chain.
    """

    terminals: Terminals
    witness: Witness
    account: Signer
    feed: Feed
    retries: Retries
    wake: ClockedEvent
    stands: Callable[[Task], bool]
    save: Callable[[Job], None]


class Attempt:
    """Deliveries of one dock, one after the other."""

    def __init__(self, process: Process, dock: DockConfig, hands: Hands) -> None:
        self._process = process
        self._dock = dock
        self._hands = hands

    def deliver(self, job: Job, path: Path, binding: Binding | None) -> str | None:
        """Do the session; the SHA-256 of its sealed recording, None when asked to stop before its end."""
        chain, hands = self._wait_chain(), self._hands
        if binding is None or chain is None:
            return None
        least_wh = hands.terminals.least_order_wh
        order, problem = _order(self._process, self._dock, job, path, binding, least_wh)
        seals = SealPublisher(self._process.bus, self._process.site.org, self._dock.name)
        clock = self._process.clock
        try:
            delivery = Delivery(order, chain, hands.witness.publish, hands.account, clock, hands.save, seals)
        except RecordingSealed:  # killed between sealing and submitting
            seals.close()
            with path.open("rb") as file:
                return "0x" + file_digest(file, "sha256").hexdigest()
        hands.feed.begin(delivery)
        try:
            if problem is not None:
                log.warning("task %d cannot be done: %s", job.task.id, problem)
                delivery.stop(End.BAD_TASK)
            with closing(self._listen(order, delivery)) as listener:
                self.attend(delivery, listener)
                if delivery.session.ended and job.session.end is not End.METER_LIES:
                    self._close(delivery, listener)
        except RodeoError:
            if delivery.session.contactor_wanted:
                hands.terminals.command(False)  # nobody meters until this is over
            raise
        finally:
            hands.feed.end()
            seals.close()
        if self._process.stop.is_set():
            delivery.suspend()
            return None
        log.info(
            "%s ended: %s, %.1f Wh, %.1f of them signed by the robot",
            job.name,
            job.session.end,
            delivery.energy_wh,
            delivery.receipted_wh,
        )
        return delivery.seal().sha256

    def _wait_chain(self) -> WitnessChain | None:
        """None when asked to stop before the meter's organization is known."""
        while (chain := self._hands.witness.chain) is None and not self._process.stop.is_set():
            self._process.not_ready("the meter's organization is not known yet")
            self._hands.retries.pause(_CHAIN_WALL_S)
        return chain

    def _listen(self, order: Order, delivery: Delivery) -> StatementListener:
        """Listen to the robot's statements only."""
        site, binding, robot = self._process.site, order.binding, order.job.task.params.get("robot")
        if robot not in [one.name for one in site.robots]:
            robot = NOBODY
        scope = Scope(
            chain_id=binding.chain_id, task_manager=binding.task_manager, organization=binding.organization
        )
        return StatementListener(
            self._process.bus,
            site.org,
            lambda devices: StatementDoor(
                devices.known,
                [SiteDevice("robot", robot)],
                lambda: scope,
                self._process.clock,
                order.slack_s,
                delivery.refusals,
                delivery.heard,
            ),
            delivery.on_receipt,
            only=robot,
            hold=self._process.clock.hold,
        )

    def attend(self, delivery: Delivery, listener: StatementListener) -> None:
        """Move the contactor and report the progress until the session is over or the process has to stop."""
        checked, wake, stop = True, self._hands.wake, self._process.stop
        while not delivery.session.ended and not stop.is_set():
            self._update_status(delivery)
            if (lie := self._hands.terminals.lie) is not None:
                delivery.disbelieve(lie)
            delivery.wait(RETRY_S, wake.is_set)
            if delivery.job.session.phase is Phase.AWAITING_RECEIPT:
                self._ask(delivery, listener)
            if wake.is_set() or not checked:
                wake.clear()
                checked = self._check_assignment(delivery)
            if delivery.session.commands_contactor:
                self._move_contactor(delivery, delivery.session.contactor_wanted)
        if stop.is_set() and delivery.session.contactor_wanted:
            # Nobody meters while this process is down. The session stays open and closes it again.
            self._hands.terminals.command(False)

    def _ask(self, delivery: Delivery, listener: StatementListener) -> None:
        """Repeat what the robot did not sign, and ask for what it signed: either may have been lost."""
        unanswered = delivery.unanswered
        if unanswered is not None:
            self._hands.witness.publish(unanswered)
            listener.catch_up()

    def _close(self, delivery: Delivery, listener: StatementListener) -> None:
        """Have the robot sign the end; earlier receipts count without."""
        delivery.close_session()
        deadline_s = time.monotonic() + CLOSING_WALL_S
        while not delivery.wait_closed(RETRY_S) and time.monotonic() < deadline_s:
            if self._process.stop.is_set():
                return
            self._ask(delivery, listener)

    def _move_contactor(self, delivery: Delivery, closed: bool) -> None:
        if self._hands.terminals.command(closed):
            delivery.contactor(closed)
        else:
            self._hands.retries.pause(RETRY_S)

    def _check_assignment(self, delivery: Delivery) -> bool:
        """End the session when the task is not ours to do any more. False when the index does not answer."""
        try:
            ours = self._hands.stands(delivery.job.task)
        except (NoResponder, QueryTimeout, RemoteError) as error:
            log.info("the index does not answer: %s", error)
            return False
        if not ours:
            delivery.stop(End.CANCELLED)
        return True

    def _update_status(self, delivery: Delivery) -> None:
        self._hands.retries.update_readiness()
        params, state = delivery.job.task.params, delivery.job.session
        progress = None
        if state.soc is not None and state.started_s is not None:
            span = float(params["soc_target"]) - float(params["soc_from"])
            progress = min(max((state.soc - float(params["soc_from"])) / max(span, 1e-6), 0.0), 1.0)
        self._process.activity(
            f"task {delivery.job.task.id}: {state.phase.value}",
            progress,
            power_w=round(delivery.power_w, 1),
            energy_wh=round(delivery.energy_wh, 1),
            receipted_wh=round(delivery.receipted_wh, 1),
            **self._hands.terminals.shown,
        )


def _order(
    process: Process, dock: DockConfig, job: Job, path: Path, binding: Binding, least_wh: float
) -> tuple[Order, str | None]:
    """What is to be done, and what is wrong with the task. Orders begin at `least_wh`."""
    site, task = process.site, job.task
    params, namespace, problem = _params_of(task, site, dock, least_wh)
    assigned_s = task.assigned or 0.0
    window_s = (task.execution_deadline or assigned_s) - assigned_s
    limits = SessionLimits(
        voltage_v=dock.voltage_v,
        cutoff_a=dock.cutoff_a,
        max_energy_wh=0.0 if params is None else params.energy_wh,
        soc_target=0.0 if params is None else params.soc_target,
        deadline_s=assigned_s + window_s * (1 - PROOF_SHARE),
        give_back_s=task.grace_ends_s - min(max(site.answer_s, PROOF_SHARE * window_s), task.grace_s / 2),
    )
    order = Order(
        job=job,
        params=params,
        limits=limits,
        binding=binding,
        path=path,
        register=process.data_dir / "register.json",
        battery_topic=topics.BATTERY_STATE.name(ns=namespace),
        slack_s=stamp_slack_s(max(site.clock.speed, site.clock.idle_speed)),
        offset=process.clock_check.offset,
    )
    return order, problem


def _params_of(
    task: Task, site: Site, dock: DockConfig, least_wh: float
) -> tuple[ChargingParams | None, str, str | None]:
    """A task's parameters, the robot's namespace, and what is wrong with the task."""
    params = None
    # A robot that the site does not know publishes nothing anywhere; the problem says so.
    namespace = str(task.params.get("robot"))
    try:
        params = ChargingParams.model_validate(task.params)
        namespace = site.robot(params.robot).namespace
        require_payable(task, params, site, dock.name)
    except (ValidationError, RodeoError) as error:
        return params, namespace, str(error)
    return params, namespace, wrong_order(task, params, site, dock, least_wh)
