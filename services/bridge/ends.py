"""What a bridge does of itself at the end of each window."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent import futures
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

from eth_account.signers.local import LocalAccount

from rodeo.bus.messages import Standing
from rodeo.bus.sending import count_sent
from rodeo.errors import ClockUnavailable, RodeoError
from rodeo.host.clocked import ClockedEvent, Rest
from rodeo.judging import rulings
from rodeo.judging.verdicts import FAULTS, LAST_RULINGS, counted_voids
from rodeo.runtime.process import Process
from services.bridge.attachment import Attachment
from services.bridge.names import ORGANIZATION
from services.bridge.offers import Match, Update, due_matches, due_updates
from services.bridge.wallet import Wallet

log = logging.getLogger(__name__)

_EXPIRY_PERIOD_S, _EXPIRY_RETRY_S = 0.5, 5.0
"""Wall time between two looks while the bridge is not ready, and while nothing changes; the latter also
before the same is tried again."""
_HAND_BACK_PERIOD_S = 1.0


class Ends:
    """Does what is due at the end of each window, and gives back what nobody here can do.

    Args:
        attached: what this bridge is attached to; None while it is not ready.
        accounts: by name.
        threads: in which the commands of each wallet are checked.
    """

    def __init__(
        self,
        process: Process,
        attached: Callable[[], Attachment | None],
        accounts: Callable[[], Mapping[str, LocalAccount]],
        threads: Mapping[str, ThreadPoolExecutor],
    ) -> None:
        self._process, self._clock, self._stop = process, process.clock, process.stop
        self._attached, self._accounts, self._threads = attached, accounts, threads
        self._expiring: dict[End | Update | Match, float] = {}
        """What is done at the end of a time -> wall time (monotonic) before which it is not tried again."""
        self._sent: dict[End | Update | Match, Future[Any]] = {}
        """What is sent and not mined yet."""
        self._changed = ClockedEvent(process.clock)
        self._thread = threading.Thread(target=self._watch, name="windows", daemon=True)
        self._giving_back: dict[tuple[int, int], tuple[Future[Any], float]] = {}
        self._give_back_due_s = 0.0
        self._given_back: set[tuple[int, int]] = set()

    def start(self) -> None:
        self._thread.start()

    def join(self) -> None:
        self._thread.join(_EXPIRY_RETRY_S)

    def changed(self) -> None:
        """A window may have begun or ended: a simulated clock may jump then."""
        self._changed.set()

    def _watch(self) -> None:
        """Do what is to be done at the end of each window. A clock that waits for this bridge does not pass
        the end of one before it is dealt with."""
        self._changed.loop(self._stop, self._look)

    def _look(self) -> Rest:
        end_s, wall_s = None, _EXPIRY_PERIOD_S
        try:
            if (attachment := self._attached()) is not None:
                end_s = self.expire_overdue(attachment)
                wall_s = _EXPIRY_RETRY_S  # each block is a change
        except ClockUnavailable:
            log.debug("the site's time is not known yet")
        except Exception:
            # Windows must end whatever happened to this look: the index may just be closed.
            log.exception("cannot look up the windows' ends; trying again")
        return Rest(end_s, wall_s)

    def expire_overdue(self, attachment: Attachment) -> float | None:
        """Returns when what passed is dealt with, or after a while; the next window's end in site time (s),
        None where none runs. Raises ClockUnavailable."""
        # Whole seconds are over for the chain when the next has begun.
        now_s = int(self._clock.now_s())
        wall_s = time.monotonic()
        index = attachment.chain.index
        self._process.notices.concern("verdicts", late_verdicts(index.tasks.late_verdicts(now_s)))
        here = {str(one.address): name for name, one in self._accounts().items() if name != ORGANIZATION}
        names = {str(one.address): name for name, one in self._accounts().items()}
        self._process.notices.concern("voids", many_voids(index.tasks.recent_voids(LAST_RULINGS), names.get))
        own, next_s = own_rulings(index.tasks.unconcluded(), here, now_s)
        updates, update_s = due_updates(index, here, attachment.handback.can_do, now_s)
        matches, match_s = due_matches(index, here, attachment.handback.can_do, now_s)
        due: list[End | Update | Match] = [*own, *updates, *matches]
        ends_s = [next_s, update_s, match_s]
        if ORGANIZATION in self._threads:
            # Anyone may end a window; for the site the organization does.
            due += [End(ORGANIZATION, "conclude", task_id) for task_id in index.tasks.concludable(now_s)]
            due += [End(ORGANIZATION, "settle_stakes", *case) for case in index.tasks.settleable(now_s)]
            due += [End(ORGANIZATION, "expire_task", task_id) for task_id in index.tasks.overdue(now_s)]
            ends_s.append(index.tasks.next_end_s(now_s))
        self._expiring = {end: retry_s for end, retry_s in self._expiring.items() if end in due}
        # Until it is mined, the index does not know of it.
        self._sent = {end: mined for end, mined in self._sent.items() if not mined.done()}
        jobs: dict[Future[Any], End | Update | Match] = {}
        for end in due:
            if end not in self._sent and self._expiring.get(end, -math.inf) <= wall_s:
                log.info("%s by %s is due", end.command, end.wallet, extra={"task": end.task_id})
                self._expiring[end] = wall_s + _EXPIRY_RETRY_S
                jobs[self._threads[end.wallet].submit(send_end, attachment.wallets[end.wallet], end)] = end
        ended, _ = futures.wait(jobs, _EXPIRY_RETRY_S)
        sent = {jobs[job]: mined for job in ended if (mined := job.result()) is not None}
        self._sent |= sent
        futures.wait(sent.values(), _EXPIRY_RETRY_S)
        if jobs:
            count_sent()  # by other threads: participants hear of the ends
        return min((end_s + 1 for end_s in ends_s if end_s is not None), default=None)

    def hand_back(self, attachment: Attachment) -> None:
        """Give back what was assigned to a participant of this bridge who cannot do it."""
        now_s = time.monotonic()
        if now_s < self._give_back_due_s:
            return
        self._give_back_due_s = now_s + _HAND_BACK_PERIOD_S
        self._giving_back = {
            key: (job, retry_s)
            for key, (job, retry_s) in self._giving_back.items()
            if not job.done() or now_s < retry_s
        }
        for name, reason, task in attachment.handback.due():
            key = task["id"], task["attempt"]
            if key not in self._giving_back and name in self._threads:
                wallet = attachment.wallets[name]
                job = self._threads[name].submit(attachment.handback.perform, wallet, reason, task)
                self._giving_back[key] = job, now_s + _EXPIRY_RETRY_S
                if key not in self._given_back:
                    self._given_back.add(key)
                    self._process.notices.warn(f"task {task['id']} is returned unfinished: {reason}")


class End(NamedTuple):
    """What is sent at the end of a window, and by whom."""

    wallet: str
    command: str
    task_id: int
    attempt: int | None = None
    """Attempt of the case whose stakes are settled: the task may be at another one by then."""

    @property
    def data(self) -> dict[str, int]:
        return {"task_id": self.task_id} | ({} if self.attempt is None else {"attempt": self.attempt})


def own_rulings(
    rows: Iterable[Mapping[str, Any]], executors: Mapping[str, str], now_s: float
) -> tuple[list[End], float | None]:
    """The tasks that `executors` (address -> name) have done and conclude themselves now, and when the next
    one is due. The organization's bridge concludes all of them earlier, unless it is away."""
    due: list[End] = []
    next_s: float | None = None
    for row in rows:
        name, standing = executors.get(row["executor"]), row["standing"]
        at_s = rulings.due_s(standing and Standing.model_validate(standing), row["verdict_deadline"])
        if name is None or at_s is None:
            continue
        if at_s < now_s:
            due.append(End(name, "conclude", row["id"]))
        else:
            next_s = at_s if next_s is None else min(next_s, at_s)
    return due, next_s


def send_end(wallet: Wallet, end: End | Update | Match) -> Future[Any] | None:
    """A job of our own, whose failure nobody else would hear of. None where it was refused."""
    try:
        reply = wallet.execute(end.command, end.data)
    except RodeoError as error:
        _warn(error, end)
        return None
    assert isinstance(reply, Future)
    reply.add_done_callback(lambda done: _warn(done.exception(), end))
    return reply


_LOST_RACES = rulings.LOST_RACES | {
    *("no_case", "window_not_over", "wrong_attempt", "deadline_not_passed"),
    *("provider_is_asleep", "bond_is_locked", "service_is_retired", "service_does_not_fit"),
}
"""Codes of refusals where somebody else was faster, or the chain's clock is behind the site's."""


def _warn(error: BaseException | None, end: End | Update | Match) -> None:
    if error is not None:
        is_lost = isinstance(error, RodeoError) and error.code in _LOST_RACES
        level = logging.INFO if is_lost else logging.WARNING
        log.log(level, "not done: %s: %s", end.command, error, extra={"task": end.task_id})


_LATE_NAMED = 5


def late_verdicts(task_ids: Sequence[int]) -> str:
    """What an operator should know of these tasks, which wait for a verdict; empty if there are none."""
    if not task_ids:
        return ""
    named, more = ", ".join(map(str, task_ids[:_LATE_NAMED])), len(task_ids) - _LATE_NAMED
    tasks = f"task{'s' if len(task_ids) > 1 else ''} {named}{f' and {more} more' if more > 0 else ''}"
    return (
        f"half of the verdict window has passed without a ruling on {tasks}: check that the judges work. "
        "Without a ruling at its end nobody is paid"
    )


def many_voids(
    recent: Mapping[str | None, tuple[int, Mapping[str, int]]], name: Callable[[str], str | None]
) -> str:
    """Against whom too many of the last rulings tell, as `Tasks.recent_voids` counts; empty if nobody. `name`
    is that of an address."""
    said = []
    for creator, (count, voids) in recent.items():
        if counted := counted_voids(count, voids, of_a_creator=creator is not None):
            whose = "this site" if creator is None else f"the creator {name(creator) or creator}"
            words = ", ".join(f"{number} {FAULTS[fault]}" for fault, number in counted.items())
            said.append(
                f"{sum(counted.values())} of the last {count} rulings on tasks of {whose} are void: {words}"
            )
    return "; ".join(said)
