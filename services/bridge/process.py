"""The bridge as a process: attach to the node and the contracts, follow, and report why when it cannot."""

from __future__ import annotations

import gc
import logging
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from prometheus_client import Counter, Histogram
from sqlalchemy.exc import DBAPIError

from rodeo.bus.messages import DaoEvent
from rodeo.bus.queries import SeenThing
from rodeo.bus.session import Request
from rodeo.chain.node.errors import (
    ChainError,
    ChainUnavailable,
    DeploymentMismatch,
    InvalidAnswer,
    NotDeployed,
    RateLimited,
    RpcFailed,
)
from rodeo.commands.errors import UnknownParticipant
from rodeo.errors import KeystoreMissing, RodeoError, WalletError
from rodeo.host.metrics import LATENCY_BUCKETS_S
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.deploying import deployment_under_way
from rodeo.site.names import BRIDGE, bridge_process, bridge_wallets
from services.bridge.attachment import Attachment, Opener
from services.bridge.contradiction import contradiction
from services.bridge.ends import Ends
from services.bridge.errors import BridgeNotReady, ChainReorganized, JournalDamaged, JournalIncomplete
from services.bridge.heads import POLL_MIN_S, SUBSCRIBED_CHECK_S, Header, Heads, PolledHeads, open_heads
from services.bridge.readiness import why_late
from services.bridge.wallet import KNOWN

log = logging.getLogger(__name__)

_RETRY_S = 0.3
"""Wall time between attempts to attach."""

_SWITCH_S = 0.0005
"""How long a thread keeps the interpreter from the one that has a block to publish."""

_NOTE_S = 2.0
"""Between two looks for transactions of our wallets that others have sent."""

_TELL_S = 1.0
"""Wall time between two reports of the index's position, which may pass a hundred blocks in a second."""

BLOCKS = Histogram(
    "rodeo_bridge_block_seconds",
    "Wall time from receiving new blocks to publishing their events",
    buckets=LATENCY_BUCKETS_S,
)
EVENTS = Counter("rodeo_bridge_events_total", "Events published on the bus", ["name"])
COMMANDS = Histogram(
    "rodeo_bridge_command_seconds",
    "Wall time from a command to its receipt",
    ["command", "outcome"],
    buckets=LATENCY_BUCKETS_S,
)
FAILURES = Counter("rodeo_bridge_failures_total", "Failures by error code", ["code"])


class Bridge:
    """Serves commands and queries on the bus from the start; answers them while it is attached."""

    def __init__(self, process: Process) -> None:
        self._process = process
        self._site: Site = process.site
        self._config = process.site.bridge
        self._public = process.name == BRIDGE
        """Whether it publishes events and answers `state` queries: only one of several bridges does so."""
        self._stop = process.stop
        self._heads: Heads = PolledHeads()
        self._reason = "starting"
        self._told_block = -1
        self._tell_s = 0.0
        self._noted_block, self._note_s = -1, 0.0
        # A thread per participant checks its commands, in their order: a stuck wallet holds up nobody else.
        self._threads = {
            name: ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
            for name in bridge_wallets(self._site)[process.name]
        }
        self._clock = process.clock
        self._opener = Opener(
            process,
            self._threads,
            self._publish if self._public else lambda _event: True,
            lambda: self._ends.changed(),
            lambda: self._heads.wake(),
            lambda thing: self._tell_of(thing),
        )
        self._ends = Ends(
            process,
            lambda: None if self._reason else self._opener.attachment,
            lambda: self._opener.accounts,
            self._threads,
        )

    def run(self) -> None:
        """Until the process is asked to stop."""
        sys.setswitchinterval(_SWITCH_S)
        self._serve()
        self._ends.start()
        while not self._stop.is_set():
            self._follow_or_say_why_not()
            self._stop.wait(_RETRY_S)
        self._opener.close()
        self._ends.join()
        for thread in self._threads.values():
            thread.shutdown(cancel_futures=True)

    def _follow_or_say_why_not(self) -> None:
        try:
            self._follow(self._opener.attach())
        except NotDeployed:
            self._not_ready(self._without_contracts("deployment record missing"))
        except DeploymentMismatch as error:
            missing = self._without_contracts("deployment record does not match the chain")
            self._not_ready(f"{missing} ({error})")
        except (ChainUnavailable, RpcFailed) as error:
            is_answer = isinstance(error, InvalidAnswer | RateLimited)
            reason = str(error) if is_answer else error.details.get("reason") or error.message
            self._not_ready(f"no node at {self._site.chain.shown_url}: {reason}")
        except KeystoreMissing as error:
            self._not_ready(str(error))
        except WalletError:
            # The passphrase comes with the environment: this process will not see another one.
            raise
        except (ChainError, ChainReorganized, JournalDamaged, JournalIncomplete) as error:
            self._not_ready(str(error))
        except DBAPIError as error:
            self._not_ready(f"the index database does not answer: {error.orig}")
            attachment = self._opener.attachment
            if attachment is not None and attachment.chain.index.is_malformed():
                self._opener.close()  # opened again, its file is set aside
        except Exception as error:
            # One unforeseen error must not end everybody's work for good.
            log.exception("following the chain failed; trying again")
            self._not_ready(f"following the chain failed: {error!r}")

    def _without_contracts(self, problem: str) -> str:
        """Why there is no organization to work for yet."""
        under_way = deployment_under_way(self._site)
        if under_way is None:
            return f"{problem}: run `rodeo site prepare`"
        return f"process {under_way.pid} is {under_way}"

    # -- chain -----------------------------------------------------------------------------------------------

    def _follow(self, attachment: Attachment) -> None:
        """Keep the index at the head. Raises ChainError when the node is gone or is another."""
        attachment.follower.publish_missed()
        self._heads = heads = open_heads(
            self._site.chain.url,
            self._site.chain.websocket_url,
            lambda why: log.info("polling the node for new blocks: %s", why),
        )
        headers: list[Header] = []
        current_s = time.monotonic()
        # Existing objects stay: to collect garbage among them takes longer than to publish a block.
        gc.collect()
        gc.freeze()
        try:
            while not self._stop.is_set():
                before = attachment.chain.index.position
                again = self._step(attachment, headers)
                headers = []
                if behind := attachment.follower.behind:
                    if time.monotonic() - current_s > self._config.max_behind_s:
                        self._not_ready(f"{behind} blocks behind the node")
                else:
                    current_s = time.monotonic()
                if again:
                    if attachment.chain.index.position == before:
                        self._stop.wait(POLL_MIN_S)  # there was nothing to continue with
                    continue
                if behind:
                    headers = heads.wait()
                    continue
                if not attachment.compared:
                    held = attachment.chain
                    problem = contradiction(held.index, held.node, held.deployment)
                    if problem is not None and attachment.made_anew:
                        self._not_ready(f"the node's contract state contradicts its events: {problem}")
                        headers = heads.wait()
                        continue
                    if problem is not None:
                        self._make_index_anew(attachment, problem)
                        continue
                    attachment.compared, attachment.made_anew = True, False
                chain = self._site.chain
                position, elsewhere = attachment.chain.index.position, chain.backend == "external"
                late = why_late(position, chain.max_block_age_s, time.time(), elsewhere)
                if late is None and attachment.transactions.failure is not None:
                    late = str(attachment.transactions.failure)
                late = late or attachment.probe.problem()
                if late is None:
                    self._ready(attachment)
                    self._note_strangers(attachment)
                    self._ends.hand_back(attachment)
                else:
                    self._not_ready(late)
                headers = heads.wait()
        finally:
            self._heads = PolledHeads()
            heads.close()

    def _make_index_anew(self, attachment: Attachment, why: str) -> None:
        """Read it from the chain again; it answers nothing meanwhile."""
        log.warning("rebuilding the index from the chain: %s", why)
        self._not_ready("the index was damaged; rebuilding it from the chain")
        attachment.chain.index.clear()
        attachment.made_anew = True

    def _step(self, attachment: Attachment, headers: list[Header]) -> bool:
        """Index the next blocks; whether there are more at once."""
        before, started_s = attachment.chain.index.position, time.perf_counter()
        again = attachment.follower.step(headers)
        if attachment.chain.index.position != before:
            BLOCKS.observe(time.perf_counter() - started_s)
        return again

    def _publish(self, event: DaoEvent) -> bool:
        """Publish the event; whether that succeeded: without a router it would be lost."""
        if not self._process.bus.connected:
            return False
        if (attachment := self._opener.attachment) is not None:
            attachment.seen.heard(event)
        self._process.bus.put_json(topics.EVENT.name(org=self._site.org, event=event.name), event)
        EVENTS.labels(event.name).inc()
        return True

    def _ready(self, attachment: Attachment) -> None:
        self._reason = ""
        self._process.ready(self._config.max_behind_s + SUBSCRIBED_CHECK_S)
        block = attachment.chain.index.position.block
        if block != self._told_block and (now_s := time.monotonic()) >= self._tell_s:
            self._told_block, self._tell_s = block, now_s + _TELL_S
            self._process.activity("following the chain", block=block)

    def _not_ready(self, reason: str) -> None:
        self._reason = reason
        self._process.not_ready(reason)

    # -- bus -------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        bus, org = self._process.bus, self._site.org
        if self._public:
            bus.serve(topics.STATE.pattern(org=org), self._answer)
            bus.serve(topics.SIGHT.pattern(org=org), self._see)

        def checker(key: str) -> ThreadPoolExecutor | None:
            return self._threads.get(_command_of(key)[0])

        if not self._site.bridges:
            # One responder for all: unknown names are answered too, and a wildcard is one name, not each.
            bus.serve(topics.COMMAND.pattern(org=org), self._execute, workers=checker)
        else:
            for name in self._threads:
                bus.serve(topics.COMMAND.pattern(org=org, participant=name), self._execute, workers=checker)

    def _attached(self) -> Attachment:
        if (attachment := self._opener.attachment) is None or self._reason:
            raise BridgeNotReady("the bridge is not ready", reason=self._reason)
        return attachment

    def _answer(self, request: Request) -> dict[str, Any]:
        parts = topics.STATE.parts(request.key) or {}
        return self._attached().queries.answer(parts.get("what", ""), request)

    def _execute(self, request: Request) -> dict[str, Any] | Future[dict[str, Any]]:
        participant, command = _command_of(request.key)
        if participant not in self._threads:
            raise UnknownParticipant("no such participant", who=participant, known=sorted(self._threads))
        return self._carry_out(participant, command, request.json)

    def _carry_out(
        self, participant: str, command: str, read: Callable[[], dict[str, Any]]
    ) -> dict[str, Any] | Future[dict[str, Any]]:
        """In the participant's thread."""
        asked = _Asked(participant, command if command in KNOWN else "unknown")
        with ExitStack() as working:
            # Held until it is mined and indexed, and its events are on the bus.
            working.enter_context(self._clock.hold())
            try:
                data = read()
                asked.about(data)
                reply = self._attached().wallets[participant].execute(command, data)
            except RodeoError as error:
                asked.ended(error)
                raise
            if isinstance(reply, Future):
                held = working.pop_all()
                reply.add_done_callback(lambda done: asked.ended(done.exception()))
                reply.add_done_callback(lambda _done: held.close())
        return reply

    def _see(self, request: Request) -> dict[str, Any]:
        """What a robot or a person tells of something on the floor."""
        parts = topics.SIGHT.parts(request.key) or {}
        seen = self._attached().seen
        thing = seen.act(parts.get("who", ""), parts.get("act", ""), request.json())
        if (post := seen.posting(thing)) is not None:
            name, command = post
            posted = self._threads[name].submit(
                self._carry_out, name, command.declared.name, lambda: command.model_dump(mode="json")
            )
            posted.add_done_callback(_log_unforeseen)
        return thing.model_dump(mode="json")

    def _tell_of(self, thing: SeenThing) -> None:
        self._process.bus.put_json(topics.SEEN.name(org=self._site.org, thing=str(thing.id)), thing)

    def _note_strangers(self, attachment: Attachment) -> None:
        """Transactions of our wallets that others have sent."""
        block, now_s = attachment.chain.index.position.block, time.monotonic()
        if block != self._noted_block and now_s >= self._note_s:
            self._noted_block, self._note_s = block, now_s + _NOTE_S
            attachment.continuity.note(attachment.transactions.orders.waiting)


def _command_of(key: str) -> tuple[str, str]:
    """(participant, command) of a command's key; empty where the key has none."""
    # A key that ends with its participant names a command that nobody knows.
    parts = topics.COMMAND.parts(key) or topics.COMMAND.parts(f"{key}/-") or {}
    return parts.get("participant", ""), parts.get("command", "")


def _log_unforeseen(posted: Future[Any]) -> None:
    # What the bridge refuses, as a task beyond the day's limit, is logged as every refusal is.
    if (error := posted.exception()) is not None and not isinstance(error, RodeoError):
        log.error("posting a seen thing failed", exc_info=error)


@dataclass
class _Asked:
    """A command, from its arrival until its outcome is known."""

    participant: str
    command: str
    task_id: int | None = None
    since_s: float = field(default_factory=time.perf_counter)

    def about(self, data: dict[str, Any]) -> None:
        task_id = data.get("task_id")
        self.task_id = task_id if isinstance(task_id, int) else None

    def ended(self, error: BaseException | None) -> None:
        outcome = "mined" if error is None else error.code if isinstance(error, RodeoError) else "internal"
        COMMANDS.labels(self.command, outcome).observe(time.perf_counter() - self.since_s)
        if error is not None:
            FAILURES.labels(outcome).inc()
            log.info(
                "%s: refused %s: %s", self.participant, self.command, error, extra={"task": self.task_id}
            )


def run(site: Site, name: str, stop: threading.Event) -> None:
    """Be the bridge `name` of `site` until `stop`. Raises ConfigError if it has none of this name."""
    own = bridge_process(site, name)
    with Process(own, site, stop) as process:
        bridge = Bridge(process)
        process.serve_alone(served_by(site, own))
        bridge.run()
