"""Several oracles: each signs what it found, publishes the signature, and posts the verdict once enough have
signed the same.

The finding is not published: it is in the signature's digest, so that only oracles with the same finding can
recognize a vote, and a listener has nothing to sign (`SealedVote`). A vote is published repeatedly until
there is a ruling, for oracles that were away. Every oracle keeps at most a few signatures of each other
oracle on each submission that waits, so nobody can fill its memory. The oracle whose own vote is the last
that was needed posts the verdict at once. The others wait in their order, and post it themselves if nobody
did. Votes of judges who are not in the panel yet are posted again when the panel has grown to them.
"""

from __future__ import annotations

import hashlib
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from rodeo.bus.messages import SealedVote, Task, Vote
from rodeo.bus.session import Bus, decode_json, validate
from rodeo.commands.judging import PostVotes
from rodeo.dao import Participant
from rodeo.errors import BusError, ClockUnavailable, RemoteError
from rodeo.host.budget import CheckBudget
from rodeo.host.clock import Clock
from rodeo.host.clocked import ClockedEvent, Rest
from rodeo.site import topics
from rodeo.site.config import Site
from services.oracle.voters import Voters

log = logging.getLogger(__name__)

REPEAT_S = 5.0
"""Wall time between two publications of one's own votes."""
TURN_S = 2.0
"""Wall time for which each oracle waits for the one before it to post what both can post."""
_FIRST_S = 0.25
"""Wall time after which the first in order posts, because the one that completed the votes posts already."""
_TIED_S = 60.0
"""Site time after which a vote is tried again whose judge's stake is committed to too much: cases end."""
_LOOK_S = 1.0
_EARLY = 4
"""Signatures kept of one oracle on a submission on which this one has not voted: until then it cannot know
which of them is that oracle's."""
_CHECKS_PER_WALL_S = 100.0
"""Signatures checked on one oracle's key: it publishes one of each submission in REPEAT_S."""
_TOO_LOW = "stake_too_low"
_REFUSED = frozenset(
    {"judge_is_party", "not_a_judge", "not_in_panel", "judge_is_auditor", "key_too_new", _TOO_LOW}
)
"""The contract does not count the vote of the judge that the error names, or not yet."""
_RULED = frozenset(
    {
        "not_challenged",
        "passed_on_before",
        "wrong_state",
        "wrong_attempt",
        "case_over",
        "too_late",
        "not_judge",
    }
)
"""Another oracle has posted the votes, or nobody can any more: the case is over, or the oracles' contract may
not judge it."""
_UNKNOWN = "transaction_timeout"
"""The votes may still be mined, so the same request is repeated rather than made anew."""

Key = tuple[int, int]


@dataclass
class _Held:
    """This oracle's vote on a submission, and who else has signed it."""

    kind: str
    submitted_s: float | None
    """Block time of the proof."""
    end_s: float
    """Site time at which the case ends."""
    vote: Vote
    report_uri: str
    signatures: dict[str, str] = field(default_factory=dict)
    """Oracle -> its signature of this vote."""
    others: dict[str, str] = field(default_factory=dict)
    """Oracle -> what was last published in its name, and does not sign this vote."""
    due_s: float | None = None
    """Wall (monotonic) time at which this oracle posts the verdict; None while the votes are too few."""
    from_s: float = -math.inf
    """Site time before which the panel is too small for these votes."""
    refusals: int = 0
    """Number of refused requests to post: the next one is another request."""
    posted: bool = False


class Votes:
    """Signs, publishes and collects votes, and posts verdicts. Thread-safe.

    Args:
        name: of this oracle.
        waits: whether a submission still waits for its verdict.
        tell: called when the votes that are held have changed.
    """

    def __init__(
        self,
        site: Site,
        name: str,
        voters: Voters,
        bus: Bus,
        wallet: Participant,
        clock: Clock,
        waits: Callable[[int, int], bool],
        tell: Callable[[], None],
    ) -> None:
        self._site, self._name, self.voters = site, name, voters
        self._bus, self._wallet, self._clock = bus, wallet, clock
        self._news = ClockedEvent(clock)
        self._waits, self._tell = waits, tell
        self._held: dict[Key, _Held] = {}
        self.early: dict[tuple[str, Key], deque[str]] = {}
        """Signatures on submissions on which this oracle has not voted yet, the newest last."""
        self._checks = CheckBudget(_CHECKS_PER_WALL_S)
        """By oracle, on whose key the signatures come."""
        self._repeated_s = 0.0
        self._acted_on: tuple[Mapping[str, int], Mapping[str, frozenset[str]]] | None = None
        """Facts by which the held votes were last counted."""
        self._lock = threading.Lock()

    def run(self, stop: threading.Event) -> None:
        """Until `stop`."""
        everybodys = topics.VOTE.pattern(org=self._site.org)
        subscription = self._bus.subscribe_with_source(
            everybodys, lambda key, payload, source: self.on_vote(key, decode_json(payload), source)
        )
        self._news.loop(stop, self._look)
        subscription.undeclare()

    def _look(self) -> Rest:
        try:
            self.forget()
            self.repeat()
            for key in self.due():
                self.post(key)
        except Exception:
            # The next votes must be posted whatever happened to these.
            log.exception("votes were not published or posted")
        return Rest(self.next_panel_s(), self.pause_s())

    @property
    def _judges(self) -> list[str]:
        return [one.name for one in self._site.oracles]

    def cast(self, task: Task, vote: Vote, report_uri: str) -> None:
        """Sign and publish this oracle's vote. Raises BusError, RemoteError."""
        signature = self.voters.sign(vote)
        if self._acted_on is None and self.voters.known is not None:
            self._acted_on = self.voters.known.counted
        key = task.id, task.attempt
        end_s = math.inf if task.case_end is None else task.case_end
        held = _Held(task.kind, task.proof_submitted, end_s, vote, report_uri, {self._name: signature})
        with self._lock:
            self._held[key] = held
            early = {name: self.early.pop((name, key), deque()) for name in self._judges}
        self._publish(key, signature)  # before the bridge is asked who votes, which may take its time
        for name, signatures in early.items():
            for one in signatures:
                self._count(held, name, one)
        with self._lock:
            if self._agreed(held):
                held.due_s = time.monotonic()  # this vote was the last that was needed
        self._tell()
        self._news.set()

    def keys(self) -> set[Key]:
        """Submissions on which this oracle has voted."""
        with self._lock:
            return set(self._held)

    def forget_all(self) -> None:
        """The chain is another one."""
        with self._lock:
            self._held.clear()
            self.early.clear()
            self._acted_on = None
            self.voters.forget()

    def held(self) -> list[dict[str, Any]]:
        """Oracles that voted as this one did on what waits, and those that voted otherwise."""
        with self._lock:
            return [
                {
                    "task_id": task_id,
                    "attempt": attempt,
                    "needed": self.voters.needed(held.kind),
                    "same": sorted(held.signatures),
                    "other": sorted(held.others.keys() - held.signatures.keys()),
                    "posted": held.posted,
                }
                for (task_id, attempt), held in sorted(self._held.items())
            ]

    def summary(self) -> list[str]:
        """A sentence for each submission that waits for the votes of others."""
        return [
            f"task {one['task_id']} attempt {one['attempt']} has {len(one['same'])} equal votes, and "
            f"{one['needed']} are needed"
            for one in self.held()
            if not one["posted"]
        ]

    # -- votes of others ---------------------------------------------------------------------------------

    def on_vote(self, key: str, data: dict[str, Any], source: str = "") -> None:
        name = (topics.VOTE.parts(key) or {}).get("judge", "")
        sealed = validate(SealedVote, data)
        submission, signature = (sealed.task_id, sealed.attempt), sealed.signature
        if name not in self._judges or name == self._name or not self._waits(*submission):
            return
        with self._lock:
            held = self._held.get(submission)
            if held is None:
                early = self.early.setdefault((name, submission), deque(maxlen=_EARLY))
                if signature not in early:
                    early.append(signature)
                return
            # Unchecked signatures are published again.
            if held.signatures.get(name) == signature or not self._checks.take(name, source):
                return
        same = self._count(held, name, signature)
        with self._lock:
            self._checks.checked(name, source, genuine=same)
            if same:
                self._take_turn(held)
        if same:
            self._tell()
            self._news.set()

    def _count(self, held: _Held, name: str, signature: str) -> bool:
        """Keep `signature` if the oracle `name` signed the same vote as this oracle with it."""
        committee = self.voters.current()
        if committee is None:
            return False  # it is published again
        same = self.voters.signing_key(held.vote, signature) == committee.keys.get(name, "")
        with self._lock:
            known = held.others.get(name) == signature
            (held.signatures if same else held.others)[name] = signature
        if not same and not known:
            # Nobody who has not seen its report can know which of both it is.
            log.warning(
                "task %d attempt %d: %s votes otherwise, or somebody publishes in its name",
                held.vote.task_id,
                held.vote.attempt,
                name,
            )
            self._tell()
        return same

    # -- the verdict ---------------------------------------------------------------------------------------

    def _agreed(self, held: _Held, without: frozenset[str] = frozenset()) -> dict[str, str]:
        """Enough signatures, as few as are needed; none where there are not as many."""
        needed = self.voters.needed(held.kind)
        without |= self.voters.unstaked(held.kind)
        counted = {name: one for name, one in sorted(held.signatures.items()) if name not in without}
        return dict(list(counted.items())[:needed]) if len(counted) >= needed else {}

    def _take_turn(self, held: _Held) -> None:
        """Post it in this oracle's turn, if the votes are enough."""
        agreed = self._agreed(held)
        if held.due_s is not None and held.from_s > self._site_s():
            held.due_s, held.from_s = None, -math.inf  # what is new may be the vote of a judge in the panel
        if agreed and held.due_s is None and not held.posted:
            held.due_s = time.monotonic() + _FIRST_S + self._turn_s(agreed)

    def _turn_s(self, agreed: Mapping[str, str]) -> float:
        """Wall time for which this oracle lets others post the votes."""
        return TURN_S * (sorted(agreed).index(self._name) if self._name in agreed else len(agreed))

    def due(self) -> list[Key]:
        now_s, site_s = time.monotonic(), self._site_s()
        with self._lock:
            return [
                key
                for key, one in self._held.items()
                if one.due_s is not None and one.due_s <= now_s and one.from_s <= site_s <= one.end_s
            ]

    def pause_s(self) -> float:
        """Wall time until something may be due."""
        now_s, site_s = time.monotonic(), self._site_s()
        with self._lock:
            due = (
                one.due_s - now_s
                for one in self._held.values()
                if one.due_s is not None and one.from_s <= site_s <= one.end_s
            )
            return min([_LOOK_S, *(max(0.0, in_s) for in_s in due)])

    def next_panel_s(self) -> float | None:
        """Site time at which the next panel is large enough; None where no votes wait for one."""
        site_s = self._site_s()
        with self._lock:
            waiting = (one.from_s for one in self._held.values() if one.due_s is not None)
            return min((from_s for from_s in waiting if from_s > site_s), default=None)

    def _site_s(self) -> float:
        """Site time. Before the clock was heard no window has ended, and no panel has grown."""
        try:
            return self._clock.now_s()
        except ClockUnavailable:
            return -math.inf

    def post(self, key: Key) -> None:
        """Post the verdict; votes that the contract does not count, or not yet, are left out."""
        without: frozenset[str] = frozenset()
        later_s: list[float] = []
        while self._waits(*key):
            with self._lock:
                held = self._held.get(key)
                if held is None:
                    return
                agreed = self._agreed(held, without)
                held.due_s = time.monotonic() + TURN_S if agreed or later_s else None
                if not agreed:
                    held.from_s = min(later_s, default=-math.inf) + self._turn_s(self._agreed(held))
                    held.from_s = min(held.from_s, held.end_s)
                    return
            try:
                self._wallet.command("post_votes", self._request(held, agreed))
                log.info("task %d attempt %d: posted the verdict of %s", *key, ", ".join(agreed))
                self._is_posted(held)
                return
            except RemoteError as error:
                held.refusals += error.code != _UNKNOWN
                refused = self._refused(error, held, agreed)
                if error.code in _RULED:
                    log.info("task %d attempt %d: these votes are not needed any more: %s", *key, error)
                    self._is_posted(held)
                    return
                if error.code not in _REFUSED or refused not in agreed:
                    log.info("task %d attempt %d: the votes were not posted: %s", *key, error)
                    return
                log.warning("task %d attempt %d: the vote of %s does not count: %s", *key, refused, error)
                without |= {refused}
                again_s = self._again_s(held, error)
                if again_s is not None and again_s <= held.end_s:
                    later_s.append(again_s)
            except BusError as error:
                log.warning("task %d attempt %d: the votes cannot be posted: %s", *key, error)
                return

    def _is_posted(self, held: _Held) -> None:
        with self._lock:
            held.due_s, held.posted = None, True
        self._tell()

    def _request(self, held: _Held, agreed: Mapping[str, str]) -> PostVotes:
        """The same votes are the same request, which the bridge sends once, until it was refused."""
        by = hashlib.sha256("".join(agreed.values()).encode()).hexdigest()[:32]
        return PostVotes(
            request_id=f"votes-{held.vote.task_id}-{held.vote.attempt}-{by}-{held.refusals}",
            vote=held.vote,
            report_uri=held.report_uri,
            signatures=list(agreed.values()),
        )

    def _again_s(self, held: _Held, error: RemoteError) -> float | None:
        """Site time from which the vote of the judge that the error names may count: the judge is in the
        panel then, or its stake may be free again. None for never."""
        if error.code == _TOO_LOW:
            return self._site_s() + _TIED_S
        committee = self.voters.current()
        panel, rotation_s = (0, 0) if committee is None else committee.panels.get(held.kind, (0, 0))
        if error.code != "not_in_panel" or held.submitted_s is None or not rotation_s:
            return None
        return held.submitted_s + rotation_s * (int(error.details["place"]) - panel + 1)

    def _refused(self, error: RemoteError, held: _Held, posted: Mapping[str, str]) -> str:
        """The oracle whose seat the contract's error names, or the key that signed its vote, which may be
        another's by now."""
        named, committee = {str(value) for value in error.details.values()}, self.voters.current()
        if committee is None:
            return ""
        if error.code == _TOO_LOW:
            return committee.seats.get(int(error.details["seat"]), "")
        signers = {name: self.voters.signing_key(held.vote, one) for name, one in posted.items()}
        return next((name for name, by in signers.items() if by in named), "")

    # -- one's own votes -----------------------------------------------------------------------------------

    def repeat(self) -> None:
        if time.monotonic() < self._repeated_s + REPEAT_S:
            return
        self._repeated_s = time.monotonic()
        with self._lock:
            own = {key: held.signatures[self._name] for key, held in self._held.items()}
        for key, signature in own.items():
            self._publish(key, signature)
        if own and (now := self.voters.current()) is not None and now.counted != self._acted_on:
            self._acted_on = now.counted
            with self._lock:
                for held in self._held.values():
                    self._take_turn(held)
            self._tell()

    def _publish(self, key: Key, signature: str) -> None:
        sealed = SealedVote(task_id=key[0], attempt=key[1], signature=signature)
        self._bus.put_json(topics.VOTE.name(org=self._site.org, judge=self._name), sealed)

    def forget(self) -> None:
        """Forget submissions that have their verdict."""
        with self._lock:
            known = [*self._held, *(key for _, key in self.early)]
        decided = {key for key in known if not self._waits(*key)}
        with self._lock:
            for key in decided:
                self._held.pop(key, None)
            for name, key in list(self.early):
                if key in decided:
                    del self.early[name, key]
        if decided:
            self._tell()
