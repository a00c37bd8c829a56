"""A recording of poses in MCAP, played at the speed at which it was made: for tests and rehearsals.

source = "recorded"
address = "/data/poses.mcap"     # messages are geometry_msgs/msg/PoseStamped in CDR
settings = { topic = "mocap/{body}/pose", repeat = true }
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader

from rodeo.errors import ConfigError
from rodeo.host.stamps import SECOND_NS, stamp_ns
from rodeo.ros2.errors import MalformedMessage
from rodeo.ros2.types import deserialize
from rodeo.site import topics
from services.mocap.sources import Frame, Opening, Pose, Settings, SourceKind

log = logging.getLogger(__name__)

_TYPE = topics.MOCAP_POSE.type


class Chosen(Settings):
    """Settings of the source."""

    topic: str = topics.MOCAP_POSE.key
    """Topic of each body, whose name stands for `{body}`."""
    repeat: bool = False
    """Whether it begins again at its end."""


class Recording:
    """A `Source`. Raises ConfigError for a file that cannot be read or has no poses of the bodies."""

    def __init__(self, opening: Opening) -> None:
        self._path, self._deliver = Path(opening.address), opening.deliver
        self._chosen: Chosen = opening.settings
        self._topics = {self._chosen.topic.format(body=body): body for body in opening.bodies}
        try:
            self._first_ns, self._last_ns = self._span_ns()
        except (OSError, McapError, MalformedMessage) as error:
            raise ConfigError(f"the recording cannot be read: {error}", path=opening.address) from error
        self._stop = threading.Event()
        self._why = ""
        self._thread = threading.Thread(target=self._play, name="recorded", daemon=True)
        self._thread.start()

    def _span_ns(self) -> tuple[int, int]:
        """When the first and the last message of the bodies were recorded."""
        times_ns = [time_ns for time_ns, _ in self._frames()]
        if not times_ns:
            raise ConfigError("the recording has no poses of the bodies", topics=sorted(self._topics))
        return min(times_ns), max(times_ns)

    def _frames(self) -> Iterator[tuple[int, Frame]]:
        """Each frame, and when it was recorded."""
        with self._path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages():
                body = self._topics.get(channel.topic.lstrip("/"))
                if body is None:
                    continue
                said = deserialize(message.data, _TYPE)
                at, turn = said.pose.position, said.pose.orientation
                pose = Pose((at.x, at.y, at.z), (turn.w, turn.x, turn.y, turn.z))
                yield message.log_time, Frame(stamp_ns(said.header.stamp), {body: pose})

    def _play(self) -> None:
        later_ns = 0
        while not self._stop.is_set():
            at_ns = self._first_ns
            for time_ns, frame in self._frames():
                if self._stop.wait((time_ns - at_ns) / SECOND_NS):
                    return
                at_ns = time_ns
                self._deliver(frame._replace(time_ns=(frame.time_ns or 0) + later_ns))
            if not self._chosen.repeat:
                self._why = "the recording is over"
                return
            later_ns += self._last_ns - self._first_ns + _PAUSE_NS
            self._stop.wait(_PAUSE_NS / SECOND_NS)

    def problem(self) -> str:
        """See `Source`."""
        return self._why

    def close(self) -> None:
        """See `Source`."""
        self._stop.set()
        self._thread.join()


_PAUSE_NS = 20_000_000
"""Between the last frame and the first one of the repetition."""

SOURCE = SourceKind(Recording, Chosen)
