"""The transactions of all wallets: many in flight per wallet, each mined once or never.

`Orders` holds what is to be sent, `Signer` signs it, `Outcomes` finds out what became of it. One thread
drives them: it decides gas, fee and nonce, signs, writes down, sends, and waits for all of them together, so
that a hundred wallets cost the node one request instead of a hundred. A wallet whose transactions are not
mined holds up only itself.

    queued ──sign, journal──> sent ──receipt, indexed──> mined | failed
                               │ ^
                               │ └── sent again; after `stuck_s` with a higher fee
                               └── nonce went elsewhere ──> made anew, in its own place in the journal
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from rodeo.chain.node.errors import ChainUnavailable
from rodeo.errors import RodeoError
from services.bridge.chain import Chain
from services.bridge.errors import BridgeNotReady, JournalUnwritable
from services.bridge.orders import Orders
from services.bridge.outcomes import Outcomes
from services.bridge.signer import Signer

log = logging.getLogger(__name__)

_TICK_S = 0.25


class Transactions:
    """Sends for the wallets that are added to `orders` before `start`."""

    def __init__(
        self,
        chain: Chain,
        stuck_s: float = 30.0,
        on_sent: Callable[[], None] = lambda: None,
    ) -> None:
        self._journal = chain.journal
        self.orders = Orders(chain)
        self.signer = Signer(chain, self.orders)
        self.outcomes = Outcomes(chain, self.orders, self.signer, stuck_s, on_sent)
        self.failure: RodeoError | None = None
        """Why waiting jobs are not sent, and their outcomes not kept, for now."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="transactions", daemon=True)

    def start(self) -> None:
        """Take up what was sent before, and continue."""
        self.outcomes.take_up(self._journal.unfinished())
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self.orders.changed.set()
        if self._thread.is_alive():
            self._thread.join()
        for job in self.orders.jobs():
            self.orders.end(job, BridgeNotReady("the bridge is stopping", reason="stopping"))

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.step()
            except ChainUnavailable as error:
                # What was sent may or may not have arrived; only the node can tell, so ask until it answers.
                log.debug("%s", error)
                self._stop.wait(_TICK_S)
            except JournalUnwritable as error:
                if self.failure is None:
                    log.error("not sending transactions for now: %s", error)
                self.failure = error
                self._stop.wait(_TICK_S)
            except Exception as error:
                log.debug("trying again: %r", error, exc_info=True)  # `step` has said it
                self._stop.wait(_TICK_S)
            self.orders.changed.wait(_TICK_S)
            self.orders.changed.clear()

    def step(self) -> None:
        """Do whatever is due, each duty whatever becomes of the others. Raises ChainUnavailable or
        JournalUnwritable afterwards, losing nothing."""
        failures: list[Exception] = []
        duties = (
            self.outcomes.reopen_undone,
            self.outcomes.look_at_held,
            self.send_queued,
            self.outcomes.look,
        )
        for duty in duties:
            try:
                duty()
            except (ChainUnavailable, JournalUnwritable) as error:
                failures.append(error)
            except Exception as error:
                # Journaled transactions must be sent: one fault, logged here, must not stop everybody's.
                log.exception("sending failed; continuing")
                failures.append(error)
        unwritable = next((one for one in failures if isinstance(one, JournalUnwritable)), None)
        self.orders.give_up_late(self.failure or unwritable or self.outcomes.sending_trouble)
        if failures:
            raise unwritable or failures[0]
        self.failure = None

    def send_queued(self) -> None:
        """Sign and send what waits, as far as there is room."""
        jobs = self.orders.take()
        if not jobs:
            return
        try:
            signed = self.signer.sign(jobs)
        except ChainUnavailable as error:
            self.orders.postpone(jobs, error)
            return
        except BaseException:
            self.orders.put_back(jobs)
            raise
        self.outcomes.send(signed)
