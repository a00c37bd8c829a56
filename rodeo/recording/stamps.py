"""Whether a robot's drivers stamp with the site's time. Several computers may do that, each with its clock.

A message is heard later than it was stamped, and nobody knows by how much. So the quickest of the last
seconds count: what is left of their delay makes a clock that is behind look a little worse, and one that is
ahead a little better.
"""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Callable

from rodeo.bus.messages import ClockOffset
from rodeo.host.stamps import SECOND_NS
from rodeo.runtime.clock_check import LIMIT_S, TIME_SOURCE
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import Topic

COMPARED = frozenset(topics.ROBOT_STATE) - {topics.BATTERY_STATE}
"""What a proof compares in time with what others saw. A gauge is read now and then."""
_WINDOW_NS = 5 * SECOND_NS
"""For so long a message counts: a bus that was away, or a thread that was busy, delays those of a second or
two."""
_LASTED_NS = 3 * SECOND_NS // 2
"""Over so long they must have come: what waited somewhere comes all at once."""
_QUICK = 3
"""The offset is that of the message of this rank: a stamp or two may be nonsense."""
_MOST = 1000
_LOOK_NS = SECOND_NS // 4
"""Between two looks: work asks all the time."""


class _Publisher:
    def __init__(self) -> None:
        self._heard: deque[tuple[int, int]] = deque(maxlen=_MOST)
        """When a message came, by the machine's monotonic clock, and its stamp less that."""

    def add(self, stamp_ns: int, came_ns: int) -> None:
        self._heard.append((came_ns, stamp_ns - came_ns))

    def is_heard(self, now_ns: int) -> bool:
        return bool(self._heard) and now_ns - self._heard[-1][0] <= _WINDOW_NS

    def ahead_ns(self, now_ns: int) -> int | None:
        """Its clock less the monotonic one; None where too little was heard of late."""
        late = [one for one in self._heard.copy() if now_ns - one[0] <= _WINDOW_NS]
        if len(late) < _QUICK or late[-1][0] - late[0][0] < _LASTED_NS:
            return None
        return heapq.nlargest(_QUICK, (off_ns for _, off_ns in late))[-1]


class StampCheck:
    """Compares stamps with the site's time, on a site with the wall's clock.

    Args:
        now_ns: time by the clock of this process.
        offset: how far that clock is off the site's time.
    """

    def __init__(
        self,
        site: Site,
        now_ns: Callable[[], int],
        offset: Callable[[], ClockOffset | None],
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.compares = site.clock.source == "wall"
        self._now_ns, self._offset, self._monotonic_ns = now_ns, offset, monotonic_ns
        self._publishers: dict[tuple[str, bytes], _Publisher] = {}
        """By topic and publisher."""
        self._looked_ns, self._found = -SECOND_NS, ""

    def add(self, topic: Topic, name: str, gid: bytes, stamp_ns: int) -> None:
        """Take the stamp of a message that has just come on the topic's `name`."""
        if not self.compares or topic not in COMPARED:
            return
        now_ns = self._monotonic_ns()
        if (publisher := self._publishers.get((name, gid))) is None:
            # Replaced as a whole: others look meanwhile.
            publisher = _Publisher()
            live = {key: one for key, one in self._publishers.items() if one.is_heard(now_ns)}
            self._publishers = live | {(name, gid): publisher}
        publisher.add(stamp_ns, now_ns)

    @property
    def problem(self) -> str:
        """Which stamps are off by how much; "" where none are, or nobody knows yet."""
        if (now_ns := self._monotonic_ns()) - self._looked_ns >= _LOOK_NS:
            self._looked_ns, self._found = now_ns, self._look(now_ns)
        return self._found

    def _look(self, now_ns: int) -> str:
        if (own := self._offset()) is None:
            return ""
        # This clock may have been set since a message came, the monotonic one was not.
        site_ns = self._now_ns() - now_ns - round(own.off_s * SECOND_NS)
        for (name, _), publisher in self._publishers.items():
            if (ahead_ns := publisher.ahead_ns(now_ns)) is None:
                continue
            off_s = (ahead_ns - site_ns) / SECOND_NS
            if abs(off_s) - own.doubt_s > LIMIT_S:
                way = "ahead of" if off_s > 0 else "behind"
                return (
                    f"{name}: the clock that stamps it is {abs(off_s):.2f} s {way} the site's time, that of "
                    f"{TIME_SOURCE}, and {LIMIT_S:g} s are allowed; synchronize that computer of the robot "
                    "(chrony), and have its driver stamp each message when it measures"
                )
        return ""
