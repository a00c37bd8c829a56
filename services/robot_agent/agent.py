"""The robot's mind: look, decide, act, again. Everything that must survive it is on chain or in a journal."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping

from rodeo.attempts.orders import Orders
from rodeo.errors import BusError, DiskFull, RemoteError
from rodeo.evidence.errors import EvidenceError
from rodeo.host.files import is_full
from rodeo.robot.decisions import Decided, Decisions
from rodeo.robot.errors import AgentError, CapReached, Halted, JournalBroken, Stopped
from rodeo.runtime.process import Process
from services.robot_agent.activity import REFUSED_WALL_S, RETRY_WALL_S, Patience
from services.robot_agent.attempts import Attempts
from services.robot_agent.charging import Charging
from services.robot_agent.decision import Intent, Situation, reasoned, takes_work
from services.robot_agent.idle import Idle
from services.robot_agent.machine import Skills
from services.robot_agent.news import News
from services.robot_agent.offers import Offers, Turns
from services.robot_agent.participant import RobotParticipant

log = logging.getLogger(__name__)

Act = Callable[[Situation], None]


class Charges:
    """Buys energy for the robot."""

    def __init__(self, charging: Charging, orders: Orders, idle: Idle, news: News) -> None:
        self._charging, self._orders, self._idle, self._news = charging, orders, idle, news

    def buy(self, situation: Situation) -> None:
        self._idle.activity.report(f"buying a charge at {situation.soc:.0%}")
        task_id = self._charging.buy(situation.soc, ordered=situation.charge_ordered)
        self._orders.charge_bought()
        log.info("posted charging task %d", task_id)

    def wait(self, situation: Situation) -> None:
        self._idle.activity.report("waiting for a service to take the charging task")
        self._idle.wait_for_news()

    def dock(self, situation: Situation) -> None:
        assert situation.charge is not None  # decide() says DOCK only with a charging task
        self._charging.take(situation.charge, self._news.wake, self._idle.activity.report)


class Agent:
    """One robot. `live` returns when the process is asked to stop."""

    def __init__(
        self,
        process: Process,
        senses: Senses,
        attempts: Attempts,
        idle: Idle,
        offers: Offers,
        turns: Turns,
        patience: Patience,
        charges: Charges,
    ) -> None:
        self._process, self._senses, self._attempts, self._idle = process, senses, attempts, idle
        self._offers, self._turns, self._patience = offers, turns, patience
        self._acts: Mapping[Intent, Act] = {
            Intent.WORK: attempts.work,
            Intent.EXPLORE: idle.explore,
            Intent.REST: idle.rest,
            Intent.OFF: idle.be_off,
            Intent.DOCK: charges.dock,
            Intent.BUY_CHARGE: charges.buy,
            Intent.AWAIT_CHARGE: charges.wait,
        }

    def live(self) -> None:
        while True:
            self._patience.wake.clear()
            if self._process.stop.is_set():  # asked after clearing: it wakes once
                return
            try:
                self._turns.take_slot()
                self.step()
            except Stopped:
                return
            except Halted as error:
                self._idle.stand_still(error, lambda: self._senses.orders.standing.stopped)
            except JournalBroken as error:
                self._process.not_ready(str(error))
                self._patience.wait_out("waiting for a file to be restored", RETRY_WALL_S, error)
            except BusError as error:
                self._patience.wait_out(f"waiting for the organization: {error.message}", RETRY_WALL_S, error)
            except RemoteError as error:
                starting = error.code == "bridge_not_ready"
                pause_s = RETRY_WALL_S if starting else REFUSED_WALL_S
                wait = self._patience.wait_out if error.passes else self._patience.wait_refused
                wait(f"refused: {error.message}", pause_s, error)
            except CapReached as error:
                self._patience.wait_refused(f"failed, trying again: {error.message}", RETRY_WALL_S, error)
            except (AgentError, EvidenceError, DiskFull) as error:
                full = is_full(error)
                if full:
                    self._process.not_ready(f"waiting for room on the disk: {error}")
                trouble = "waiting for room on the disk" if full else f"failed, trying again: {error.message}"
                self._patience.wait_out(trouble, RETRY_WALL_S, error)

    def step(self) -> None:
        situation = self._senses.look()
        intent, reason = reasoned(situation, self._process.site.agent)
        unfit = self._process.clock_check.problem or self._idle.machine.body.unfit()
        self._senses.keep(situation, intent, reason)
        if intent is not Intent.OFF and self._idle.switch_on():
            return
        if intent is not Intent.WORK and not self._senses.orders.standing.paused:
            self._idle.free_the_gripper()
        if self._attempts.gave_back(situation):
            return
        if intent is not Intent.WORK:
            # A task to be done comes first: its motion must not wait for the chain.
            self._offers.name_payout()
            wanted = situation.able if takes_work(situation) and not unfit else ()
            if wanted:
                self._turns.let_others_begin(self._idle.activity.report, self._senses.check)
            self._offers.open(wanted)
        if unfit:
            self._process.not_ready(unfit)
        else:
            self._process.ready()
        self._acts[intent](situation)


def check_orders(stop: threading.Event, orders: Orders) -> None:
    """Raises Stopped and Halted."""
    if stop.is_set():
        raise Stopped("the process is asked to end")
    if orders.standing.stopped:
        raise Halted("stopped by an operator")


class Senses:
    """Looks at chain, body and orders."""

    def __init__(
        self,
        process: Process,
        energy: str,
        dao: RobotParticipant,
        skills: Skills,
        attempts: Attempts,
        idle: Idle,
        orders: Orders,
        decisions: Decisions,
    ) -> None:
        self._process, self._energy, self._dao, self._skills = process, energy, dao, skills
        self._attempts, self._idle, self._decisions = attempts, idle, decisions
        self.orders = orders

    def check(self) -> None:
        """Raises Stopped and Halted."""
        check_orders(self._process.stop, self.orders)

    def look(self) -> Situation:
        """The present situation. The body of a robot that is off is not asked."""
        self.check()
        standing, body = self.orders.standing, self._idle.machine.body
        charge = self._dao.own_live_task(self._energy)
        off = self._idle.off_since
        soc = body.battery().soc if off is None else off.soc
        assignment = next(iter(self._dao.given(self._skills.behaviours)), None)
        able: frozenset[str] = frozenset()
        if off is not None:
            battery_suffices, able = off.battery_suffices, off.able
        elif assignment is not None:
            battery_suffices = self._skills.suffices(soc, assignment, body.base_pose())
        else:
            able = frozenset(self._skills.able(soc, body.base_pose()))
            battery_suffices = bool(able)
        return Situation(
            soc=soc,
            assignment=assignment,
            charge=charge,
            battery_suffices=battery_suffices,
            able=able,
            begun=assignment is not None and self._attempts.has_begun(assignment),
            paused=standing.paused or bool(self._process.disk.problem),
            charge_ordered=standing.charge,
            off_duty=self._idle.off_duty,
            explored_enough=self._idle.explored_enough,
        )

    def keep(self, now: Situation, intent: Intent, reason: str) -> None:
        """Keep the decision for those who ask why."""
        charge = now.charge
        decided = Decided(
            time_s=round(self._process.clock.now_s(), 3),
            intent=intent,
            reason=reason,
            soc=round(now.soc, 4),
            task_id=now.assignment and now.assignment.id,
            charge_id=charge and charge.id,
            charge_state=charge and charge.state,
            battery_suffices=now.battery_suffices,
            able=sorted(now.able),
            begun=now.begun,
            paused=now.paused,
            charge_ordered=now.charge_ordered,
            off_duty=now.off_duty,
            explored_enough=now.explored_enough,
        )
        try:
            self._decisions.add(decided)
        except OSError as error:
            log.debug("cannot keep the decision: %s", error)
