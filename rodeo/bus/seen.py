"""Messages of robots and people to the bridge about things on the floor, and their client."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from rodeo.bus import queries
from rodeo.bus.messages import Id, Kind, Message
from rodeo.bus.queries import SeenThing, Word
from rodeo.bus.session import Bus
from rodeo.site import topics

REPORT, GONE, SAY = "report", "gone", "say"
"""The acts: of a robot, of a robot, of a person."""

Extent = Annotated[float, Field(gt=0, le=2.0, allow_inf_nan=False)]


class SightReport(Message):
    """A robot saw something on the floor that no site file lists."""

    kind: Kind
    """Kind of work that would take it away."""
    x_m: Annotated[float, Field(allow_inf_nan=False)]
    y_m: Annotated[float, Field(allow_inf_nan=False)]
    """Its place in the map."""
    size_m: Annotated[list[Extent], Field(min_length=3, max_length=3)]
    """Its extents, at most 2 m each."""
    photo: Annotated[str, Field(max_length=100)]
    """Name of a picture of it in the site's store (`rodeo.person.photos.keep`)."""


class SeenId(Message):
    """A robot saw that a thing is not there any more."""

    id: Id


class Saying(SeenId):
    """A person says what a seen thing is."""

    what: Word


class Seen:
    """Tells the bridge of things on the floor in the name of a robot or of a person.

    Every method raises NoResponder or QueryTimeout when the bridge is away, and RemoteError with its error.
    """

    def __init__(self, bus: Bus, org: str, who: str) -> None:
        self._bus, self._org, self._who = bus, org, who

    def report(self, sighting: SightReport) -> SeenThing:
        """Report something: the known thing where it is the same, or a new one.

        It is the same within 0.25 m of one that is open or about which there is a task, and where it has the
        size of one that a person dismissed. So report what is seen again, too: that keeps it current.

        Raises RemoteError `too_many_seen` where the robot has too many open, and `invalid_request` where no
        task could be posted about such a place.
        """
        return self._tell(REPORT, sighting)

    def gone(self, thing_id: int) -> SeenThing:
        """Withdraw a thing, whoever reported it, of which nothing is left. One that has a task, or that a
        person dismissed, stays as it is."""
        return self._tell(GONE, SeenId(id=thing_id))

    def say(self, thing_id: int, what: Word) -> SeenThing:
        """Say in a person's name what a thing is."""
        return self._tell(SAY, Saying(id=thing_id, what=what))

    def things(self, **filters: Any) -> list[SeenThing]:
        """The newest things that pass the filters of `state/seen`; by default those of today's work."""
        return queries.ask(self._bus, self._org, queries.SEEN, **filters).things

    def _tell(self, act: str, request: Message) -> SeenThing:
        key = topics.SIGHT.name(org=self._org, who=self._who, act=act)
        return queries.fitting(SeenThing, self._bus.query(key, request), key)
