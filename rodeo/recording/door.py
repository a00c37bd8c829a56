"""The recorder's door: which ROS 2 messages are written, and how many of which kind of nonsense are not.

Anybody may err, and on an open bus anybody may publish. What is written is one publisher's messages of each
topic, in order, each of the same layout as the first. The rest costs the recording nothing.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from enum import StrEnum
from typing import Literal

from rodeo.evidence.container import Limits
from rodeo.evidence.errors import LayoutChanged
from rodeo.evidence.layout import Layout
from rodeo.host.budget import Bucket
from rodeo.host.metrics import RECORDER_REFUSED
from rodeo.host.stamps import FASTEST_CLOCK, SECOND_NS
from rodeo.lab.rates import FASTEST_HZ
from rodeo.ros2 import plain
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.errors import MalformedMessage
from rodeo.ros2.readings import MOST_PUBLISHERS, SILENT_WALL_S, bare
from rodeo.site import topics
from rodeo.site.topics import Topic

What = Literal["message", "statement"]


class Refusal(StrEnum):
    """Why something was not written."""

    MALFORMED = "malformed"
    """It cannot be read, or not as those before it."""
    NOT_A_NUMBER = "not_a_number"
    """Or an orientation is no rotation."""
    MISADDRESSED = "misaddressed"
    """It names another frame, device, organization or chain than those that belong on this key."""
    DOUBLED = "doubled"
    """It was there before: by number, by stamp, or by digest."""
    ABSURD_TIME = "absurd_time"
    ABSURD_NUMBER = "absurd_number"
    """A sequence number that the time since the last one cannot explain."""
    STRANGER = "stranger"
    """No registered device of this site signed it, or not the publisher that is followed sent it."""
    UNASKED = "unasked"
    """Nobody could be asked yet which devices there are; its journal is asked later."""
    BAD_SIGNATURE = "bad_signature"
    UNVERIFIED = "unverified"
    """Too many signatures to check at once; the journal is asked instead."""
    OVER_BUDGET = "over_budget"
    """More than its source has any reason to say."""


class Refusals:
    """Counts what was not written. Thread-safe."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()

    def count(self, what: What, reason: Refusal) -> None:
        RECORDER_REFUSED.labels(what, reason.value).inc()
        with self._lock:
            self._counts[f"{what}:{reason.value}"] += 1

    def summary(self) -> dict[str, int]:
        """`message:doubled` and so on -> how many."""
        with self._lock:
            return dict(sorted(self._counts.items()))


LEFT_OUT = "left_out"
"""Event near the end of a recording: {"event", "counts"}, see `Refusals.summary`."""

STAMP_SLACK_WALL_S = 15.0
"""A busy machine hears clock and messages late; a fast clock makes more of it."""
_ON_DEMAND_HZ = 20.0
"""Most messages of a topic without a rate."""
_SAVED_S = 2.0
"""A publisher that was silent may send the messages of this time at once."""
_LOST = 500
"""Messages that may be lost at once without time to explain them: a queue that overflowed."""
_EARLIEST_NS = Limits().earliest_ns
"""A file with an earlier message is refused."""
_SEQUENCES = 2**32
"""A recording has 32 bits for them."""

_FRAMES = {topics.POSE.key: "map", topics.ITEM_POSE.key: "map"}
"""Where the frame of a message is not the publisher's own choice."""
_NUMBERS: dict[str, tuple[str, ...]] = {
    topics.ODOM.key: ("pose.pose.", "twist.twist."),
    topics.JOINT_STATES.key: (),
    topics.ARM_STATE.key: ("reference.positions", "feedback.positions"),
    topics.GRIPPER_STATE.key: ("reference.positions", "feedback.positions"),
    topics.BATTERY_STATE.key: ("voltage", "percentage"),
    topics.DOCK_OUTPUT.key: ("voltage", "current"),
    topics.POSE.key: ("pose.",),
    topics.ITEM_POSE.key: ("pose.",),
    topics.BIN_LOAD.key: ("wrench.",),
}
"""What must be finite. The rest may be unmeasured, which ROS 2 says with NaN; of joints that may be the
positions of wheels, and whoever judges looks at those of the arm (`rodeo.checks.tables`)."""


def stamp_slack_s(speed: float) -> float:
    """Seconds of site time that a stamp may be off the site's clock, which runs `speed` times as fast as the
    wall's; at 0 as fast as it can."""
    return STAMP_SLACK_WALL_S * max(1.0, speed or FASTEST_CLOCK)


class _Publisher:
    """One whose messages are written."""

    def __init__(self, layout: Layout, joints: frozenset[str], budget: Bucket) -> None:
        self.layout, self.joints, self.budget = layout, joints, budget
        self.sequence = self.stamp_ns = 0
        self.heard_s = -math.inf


class MessageDoor:
    """Decides for one topic. One thread at a time.

    What is written is all that the publisher says up to `FASTEST_HZ`: whoever could choose would hide a jump.
    Joints may have several publishers, each of which says other ones.

    Args:
        slack_s: how far a stamp may be off the site's clock, see `stamp_slack_s`.
        wall_s: monotonic wall time.
    """

    def __init__(self, topic: Topic, slack_s: float, wall_s: Callable[[], float] = time.monotonic) -> None:
        self._type = topic.type
        self._frame = _FRAMES.get(topic.key)
        self._numbers = _NUMBERS[topic.key]
        self._most = MOST_PUBLISHERS if topic is topics.JOINT_STATES else 1
        self._most_hz = FASTEST_HZ if topic.rate_hz else _ON_DEMAND_HZ
        self._slack_ns = round(slack_s * 1e9)
        self._wall_s = wall_s
        self._followed: dict[bytes, _Publisher] = {}
        """By the publisher's identity. What one says that was heard no more is for the next."""
        self.stamp_ns = 0
        """Stamp of the last message that may be written."""

    def refusal(self, info: MessageInfo, now_ns: int) -> Refusal | None:
        """Why this message must not be written at `now_ns` of site time; None when it may."""
        try:
            stamp_ns = plain.stamp_ns(info.cdr)
        except MalformedMessage:
            return Refusal.MALFORMED
        if int.from_bytes(info.cdr[8:12], "little") >= SECOND_NS:
            return Refusal.ABSURD_TIME  # nanoseconds that are more than a second
        if not 0 <= info.sequence < _SEQUENCES:
            return Refusal.ABSURD_NUMBER
        # The publisher's own time may be the wall's, on a simulated site too, but not one to come.
        latest_ns = max(now_ns, time.time_ns()) + self._slack_ns
        if abs(stamp_ns - now_ns) > self._slack_ns or not _EARLIEST_NS <= info.source_time_ns <= latest_ns:
            return Refusal.ABSURD_TIME
        followed = self._followed.get(info.gid)
        publisher = self._new(info) if followed is None or self._is_silent(followed) else followed
        if isinstance(publisher, Refusal):
            return publisher
        if not publisher.layout.fits(info.cdr):
            return self._misfit(publisher.layout, info.cdr)
        if not publisher.layout.finite(info.cdr) or not publisher.layout.turned(info.cdr):
            return Refusal.NOT_A_NUMBER
        if (refusal := self._misplaced(publisher, info, stamp_ns)) is not None:
            return refusal
        if not publisher.budget.take(stamp_ns * 1e-9):
            return Refusal.OVER_BUDGET
        replaced = [gid for gid, one in self._followed.items() if one.joints & publisher.joints]
        for gid in replaced:
            del self._followed[gid]
        self._followed[info.gid] = publisher
        publisher.sequence, publisher.stamp_ns = info.sequence, stamp_ns
        publisher.heard_s = self._wall_s()
        self.stamp_ns = stamp_ns
        return None

    def _is_silent(self, publisher: _Publisher) -> bool:
        return self._wall_s() - publisher.heard_s >= SILENT_WALL_S

    def _new(self, info: MessageInfo) -> _Publisher | Refusal:
        """The publisher of that, to be followed unless it says something else that must not be written."""
        live = [one for gid, one in self._followed.items() if gid != info.gid and not self._is_silent(one)]
        if len(live) >= self._most:
            return Refusal.STRANGER
        try:
            layout = Layout(self._type, info.cdr, self._numbers)
        except LayoutChanged:
            return Refusal.MALFORMED
        if self._frame is not None and layout.strings["header.frame_id"].removeprefix("/") != self._frame:
            return Refusal.MISADDRESSED
        joints = frozenset({""})
        if self._most > 1:
            named = [bare(text) for path, text in layout.strings.items() if path.startswith("name[")]
            joints = frozenset(named)
            if not joints or len(joints) < len(named):
                return Refusal.MALFORMED
        if any(one.joints & joints for one in live):
            return Refusal.STRANGER
        publisher = _Publisher(layout, joints, Bucket(self._most_hz, max(_SAVED_S * self._most_hz, 2.0)))
        for before in self._followed.values():
            if before.joints & joints:
                if not before.layout.fits(info.cdr):
                    return self._misfit(before.layout, info.cdr)
                # A stamp that was written already would be there twice, whoever says it now.
                publisher.stamp_ns = max(publisher.stamp_ns, before.stamp_ns)
        return publisher

    def _misfit(self, layout: Layout, cdr: bytes) -> Refusal:
        try:
            other = Layout(self._type, cdr, self._numbers)
        except LayoutChanged:
            return Refusal.MALFORMED
        moved = other.strings["header.frame_id"] != layout.strings["header.frame_id"]
        return Refusal.MISADDRESSED if moved else Refusal.MALFORMED

    def _misplaced(self, publisher: _Publisher, info: MessageInfo, stamp_ns: int) -> Refusal | None:
        """What keeps the message from being the next of its publisher."""
        if publisher.heard_s == -math.inf:
            return Refusal.DOUBLED if stamp_ns == publisher.stamp_ns else None
        if info.sequence <= publisher.sequence or stamp_ns <= publisher.stamp_ns:
            return Refusal.DOUBLED
        lasted_s = (stamp_ns - publisher.stamp_ns) * 1e-9
        if info.sequence - publisher.sequence > _LOST + self._most_hz * lasted_s:
            return Refusal.ABSURD_NUMBER
        return None
