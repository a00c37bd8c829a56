"""The smart bin as the robot knows it: signed statements about what it was shown and what fell."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from functools import partial
from typing import TypeVar, get_args

from rodeo.bus.session import Bus
from rodeo.errors import BusError, RemoteError
from rodeo.evidence.attestation import Attestation
from rodeo.host.clock import Clock, Patience
from rodeo.lab.drop import WEIGHS_THE_SAME_N
from rodeo.recording.door import Refusals, stamp_slack_s
from rodeo.recording.statements import Heard, StatementDoor, StatementListener
from rodeo.robot.errors import NoAnswer
from rodeo.robot.interrupts import Interrupts
from rodeo.signing.keystores import SiteDevice
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness.statement import Claimant, Classification, Drop, Presentation, Removal, Scope
from rodeo.witness.witness import Witness

log = logging.getLogger(__name__)

Word = Classification | Drop | Removal
Kind = TypeVar("Kind", Classification, Drop)

_ASK_PERIOD_S = 2.0
"""Wall time after which the bin is asked in case its message was lost (a router that restarts loses it)."""
_PRESENT_PERIOD_S = 1.0
"""Wall time after which the robot presents itself again, for the same reason."""
_ANSWER_WALL_S = 2.0
"""The bin answers at once, or not at all."""
_KEPT = 50
"""Statements of each kind."""


class SmartBin:
    """Hears what one bin of the site states, and presents the robot to it.

    A statement's own time counts, not when it was heard. Close it before the bus.
    """

    def __init__(
        self, bus: Bus, site: Site, name: str, clock: Clock, witness: Witness, interrupts: Interrupts
    ) -> None:
        """`witness` signs for the robot."""
        self._bus = bus
        self._clock = clock
        self._interrupts = interrupts
        self._name = name
        self._witness = witness
        self._state_key = topics.BIN_STATE.name(org=site.org, bin=name)
        self._words: dict[type[Word], deque[Word]] = {kind: deque(maxlen=_KEPT) for kind in get_args(Word)}
        self._lock = threading.Lock()
        self._presented: Attestation | None = None
        self.listener = StatementListener(
            bus,
            site.org,
            lambda devices: StatementDoor(
                devices.known,
                [SiteDevice("bin", self._name)],
                self._scope,
                clock,
                stamp_slack_s(site.clock.speed),
                Refusals(),
            ),
            self._on_statement,
            only=self._name,
            hold=partial(clock.hold, within=True),
        )

    def close(self) -> None:
        self.listener.close()

    # -- telling the bin -------------------------------------------------------------------------------

    def present(self, claimant: Claimant, grasped_s: float) -> None:
        """Say for whose recording the robot shows something next, which it took hold of at `grasped_s` (site
        time); said again while it waits for an answer.

        Raises NoAnswer while it is not known for which organization the robot signs.
        """
        chain = self._witness.chain
        if chain is None:
            raise NoAnswer("the bridge has not yet named the organization that the robot signs for")
        fields = claimant.model_dump(include={"recording", "task_id", "attempt"})
        self._presented = chain.sign(
            Presentation, self._clock.now_s(), bin=self._name, grasped_s=grasped_s, **fields
        )
        self._witness.publish(self._presented)

    # -- hearing it ------------------------------------------------------------------------------------

    def said_after(self, kind: type[Kind], time_s: float) -> Kind | None:
        """Its last statement of this kind about what was later than `time_s` (site time)."""
        with self._lock:
            words = [one for one in self._words[kind] if isinstance(one, kind) and moment_s(one) > time_s]
        return max(words, key=moment_s, default=None)

    def removed(self, drop: Drop) -> Removal | None:
        """What the bin says that was taken out of the compartment since the drop and weighs as much as what
        fell: others may empty the bin meanwhile."""
        self._ask()
        with self._lock:
            words = [one for one in self._words[Removal] if isinstance(one, Removal)]
        since = [o for o in words if o.compartment == drop.compartment and o.settled_s > drop.after_s]
        return next((o for o in since if abs(o.weight_n - drop.weight_n) <= WEIGHS_THE_SAME_N), None)

    def wait_for(self, kind: type[Kind], after_s: float, timeout_wall_s: float) -> Kind:
        """A statement about what was later than `after_s` (site time).

        Raises NoAnswer after `timeout_wall_s`. Wall time, because another process has to work, however fast
        the site's clock runs; what is waited for does not come while that stands, see `Patience`.
        """
        now_s = time.monotonic()
        patience = Patience(self._clock, timeout_wall_s)
        look_s = now_s + timeout_wall_s
        ask_s = now_s + _ASK_PERIOD_S
        present_s = now_s + _PRESENT_PERIOD_S if kind is Classification else math.inf
        while True:
            said = self.said_after(kind, after_s)
            if said is not None:
                return said
            self._clock.wait_for(
                lambda: self.said_after(kind, after_s) is not None,
                wall_s=min(look_s, ask_s, present_s) - now_s,
                check=self._interrupts.check,
            )
            now_s = time.monotonic()
            look_s = look_s if now_s < look_s else math.inf
            if patience.is_over:
                if not self.listener.answered:
                    raise NoAnswer(
                        "the bridge did not answer which devices are registered, so the robot cannot check "
                        "the bin's signatures",
                        timeout_s=timeout_wall_s,
                    )
                last = self.said_after(kind, float("-inf"))
                raise NoAnswer(
                    f"the bin {self._name} sent no {kind.__name__.lower()}",
                    timeout_s=timeout_wall_s,
                    after_s=after_s,
                    last_s=None if last is None else moment_s(last),
                )
            if now_s >= ask_s:
                self._ask()
                ask_s = time.monotonic() + _ASK_PERIOD_S
            if now_s >= present_s:
                if self._presented is not None:
                    self._witness.publish(self._presented)
                present_s = now_s + _PRESENT_PERIOD_S

    # -- inside ----------------------------------------------------------------------------------------

    def _scope(self) -> Scope | None:
        chain = self._witness.chain
        return None if chain is None else chain.scope

    def _on_statement(self, heard: Heard) -> None:
        if isinstance(heard.statement, Word):
            with self._lock:
                self._words[type(heard.statement)].append(heard.statement)
            self._clock.notify()

    def _ask(self) -> None:
        """For its last statements, and through the journal for what was missed in between."""
        try:
            state = self._bus.query(self._state_key, timeout_s=_ANSWER_WALL_S)
        except (BusError, RemoteError) as error:
            log.info("the bin does not answer: %s", error)
            return
        last = [state[kind] for kind in ("classification", "disposal") if state.get(kind) is not None]
        self.listener.read(self._name, {"statements": last})
        self.listener.catch_up()


def names(said: Classification, claimant: Claimant) -> bool:
    """Whether the bin says that `claimant` showed it. Addresses may differ in case."""
    own = claimant.address.lower(), claimant.recording, claimant.task_id, claimant.attempt
    return own in [(o.address.lower(), o.recording, o.task_id, o.attempt) for o in said.claimants]


def moment_s(word: Word) -> float:
    """Site time of what a statement is about."""
    return word.shown_s if isinstance(word, Classification) else word.settled_s
