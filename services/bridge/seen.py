"""Keeps what robots see on the floor and what people say of it, in one file for each thing.

The files lie beside the wallets' journal, not in the index, which is made anew from the chain.

RodeoError
└── RequestError
    ├── NotARobot       only a robot of the site reports what lies there, and only a person says what it is
    ├── UnknownSeen     there is no such thing
    ├── TooManySeen     the robot has too many things open, or has reported too many today
    └── NotForPeople    the thing is gone, or a task decides about it
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from pydantic import ValidationError

from rodeo.bus.messages import LIVE_STATES, DaoEvent
from rodeo.bus.queries import Said, SeenFilters, SeenThing
from rodeo.bus.seen import GONE, REPORT, SAY, Saying, SeenId, SightReport
from rodeo.bus.session import Request, validate
from rodeo.commands.tasks import RegisterTask
from rodeo.errors import InvalidRequest, RequestError, unreadable
from rodeo.host.clock import TimeSource
from rodeo.host.files import replace_file
from rodeo.kinds import SAME_PLACE_M, Kind, Kinds, fields, is_number
from rodeo.site.config import Site
from rodeo.text.strict_json import Json
from services.bridge.errors import UnknownCommand
from services.bridge.index import UNDONE
from services.bridge.reading import Page

log = logging.getLogger(__name__)

MAX_OPEN = 12
"""Things that one robot may have open or posted at a time."""
MAX_A_DAY = 100
"""Things that one robot may report in a day of site time, over or not."""
NOTED_S = 60.0
"""How often it is noted that a known thing is still there, site time."""
MAX_SAID = 20
"""People whose last words about one thing are kept."""
DAY_S = 86_400
_SAME_SIZE_M, _SAME_SIZE = 0.03, 0.3
"""By how much extents of one thing that was measured twice differ at most: m, or as a part of the larger."""


class NotARobot(RequestError):
    """Only a robot of the site reports what lies there, and only a person says what it is."""


class UnknownSeen(RequestError):
    """There is no such thing."""


class TooManySeen(RequestError):
    """The robot has too many things open, or has reported too many today."""


class NotForPeople(RequestError):
    """The thing is gone, or a task decides about it."""


class Tasks(Protocol):
    """The index's tasks."""

    def get(self, task_id: int, /) -> Mapping[str, Any] | None: ...
    def find(
        self, filters: Mapping[str, Any], page: Page, /, *, states: tuple[str, ...]
    ) -> tuple[Sequence[Mapping[str, Any]], int]: ...


class SeenThings:
    """The things in `folder`. `changed` is called with each that is new or changes. Thread-safe."""

    def __init__(
        self,
        folder: Path,
        site: Site,
        kinds: Kinds,
        tasks: Tasks,
        clock: TimeSource,
        changed: Callable[[SeenThing], object],
    ) -> None:
        self._folder, self._site, self._kinds = folder, site, kinds
        self._tasks, self._clock, self._changed = tasks, clock, changed
        self._robots = [robot.name for robot in site.robots]
        self._fields = {name: names for name, kind in kinds.items() if (names := place_fields(kind))}
        self._lock = threading.RLock()
        self._things: dict[int, SeenThing] = {}
        for path in folder.glob("*.json"):
            try:
                thing = SeenThing.model_validate_json(path.read_bytes())
                self._things[thing.id] = thing
            except (OSError, ValidationError) as error:
                log.warning("a seen thing is damaged and does not count: %s: %s", path, unreadable(error))

    def answer(self, request: Request) -> Json:
        """`state/seen`."""
        wanted = validate(SeenFilters, request.parameters)
        states = wanted.state.split(",")
        with self._lock:
            found = [one for number, one in sorted(self._things.items(), reverse=True) if one.state in states]
        page = found[wanted.offset : wanted.offset + wanted.limit]
        return {"things": [one.model_dump(mode="json") for one in page], "total": len(found)}

    def act(self, who: str, act: str, data: Json) -> SeenThing:
        """Take in what `who` tells; the thing as it is then. Raises RequestError, DiskFull."""
        if act not in (REPORT, GONE, SAY):
            raise UnknownCommand("no such act", command=act, known=[REPORT, GONE, SAY])
        if (who in self._robots) == (act == SAY):
            by = "a person" if act == SAY else "a robot of the site"
            raise NotARobot(f"only {by} does this", who=who, act=act, robots=self._robots)
        with self._lock:
            if act == REPORT:
                return self._report(who, validate(SightReport, data))
            if act == GONE:
                return self._gone(self._thing(validate(SeenId, data).id))
            saying = validate(Saying, data)
            return self._say(who, self._thing(saying.id), saying)

    def heard(self, event: DaoEvent) -> None:
        """Follow a task that is about a thing, or begins to be. Call it once the index holds the event."""
        if event.task_id is None:
            return
        with self._lock:
            live = [one for one in self._things.values() if one.state in ("open", "posted")]
            if not live:
                return
            task = self._tasks.get(event.task_id)
            is_live = task is not None and task["state"] in LIVE_STATES
            for one in live:
                if one.task_id == event.task_id:
                    self._follow(one, task, event.name == UNDONE)
                elif one.state == "open" and is_live and self._is_at(task, one):
                    self._keep(one, state="posted", task_id=event.task_id)

    def posting(self, thing: SeenThing) -> tuple[str, RegisterTask] | None:
        """The wallet that posts a task about a thing that nobody has spoken of, and its command.

        None where people post, and where the last task left what lies there.
        """
        name = next((one.post_seen_as for one in self._site.kinds if one.name == thing.kind), None)
        if name is None or thing.state != "open" or thing.said or self._was_left(thing):
            return None
        size = " x ".join(f"{extent:.2f}" for extent in thing.size_m)
        return name, RegisterTask(
            request_id=thing.request_id,
            kind=thing.kind,
            reward_iec=self._kinds[thing.kind].reference_price_iec,
            params=self._params(thing),
            description=f"{thing.robot} saw something of {size} m here.",
        )

    # -- acts -----------------------------------------------------------------------------------------------

    def _report(self, robot: str, seen: SightReport) -> SeenThing:
        now_s = self._clock.now_s()
        if (known := self._known(seen, now_s)) is not None:
            return known if now_s - known.last_s < NOTED_S else self._keep(known, last_s=now_s)
        self._check(robot, seen, now_s)
        task_id = self._task_at(seen)
        thing = SeenThing(
            **seen.model_dump(),
            id=max(self._things, default=0) + 1,
            robot=robot,
            first_s=now_s,
            last_s=now_s,
            state="open" if task_id is None else "posted",
            task_id=task_id,
        )
        self._forget(now_s)
        return self._keep(thing)

    def _known(self, seen: SightReport, now_s: float) -> SeenThing | None:
        """The same thing, the nearest of several. A dismissed one that has another size now, or was not seen
        for a day, is something else."""
        near = [
            (_apart_m(seen, one.x_m, one.y_m), one)
            for one in self._things.values()
            if one.state != "gone" and one.kind == seen.kind
        ]
        for _, one in sorted(((m, one) for m, one in near if m < SAME_PLACE_M), key=lambda it: it[0]):
            if one.state != "dismissed":
                return one
            if now_s - one.last_s < DAY_S and _same_size(one.size_m, seen.size_m):
                return one
            self._keep(one, state="gone")
        return None

    def _check(self, robot: str, seen: SightReport, now_s: float) -> None:
        """Raises InvalidRequest where no task could be posted, and TooManySeen."""
        if seen.kind not in self._fields:
            raise InvalidRequest(
                "the site lists no such kind whose tasks name a place", kind=seen.kind, known=[*self._fields]
            )
        if wrong := self._kinds[seen.kind].wrong_params(self._site, self._params(seen)):
            raise InvalidRequest("no task can be posted about this", kind=seen.kind, fields=wrong)
        own = [one for one in self._things.values() if one.robot == robot]
        live = sum(one.state in ("open", "posted") for one in own)
        today = sum(now_s - one.first_s < DAY_S for one in own)
        if live >= MAX_OPEN or today >= MAX_A_DAY:
            raise TooManySeen(
                "the robot has reported too much", robot=robot, open=live, most=MAX_OPEN, today=today
            )

    def _gone(self, thing: SeenThing) -> SeenThing:
        # A robot that takes back what was dismissed could propose it again.
        return self._keep(thing, state="gone") if thing.state == "open" else thing

    def _say(self, who: str, thing: SeenThing, saying: Saying) -> SeenThing:
        if thing.state == "gone" or (thing.state == "posted" and saying.what == "dismissed"):
            raise NotForPeople(
                "it is gone" if thing.state == "gone" else "a task is about it: cancel that", id=thing.id
            )
        others = [one for one in thing.said if one.who != who][1 - MAX_SAID :]
        word = Said(who=who, what=saying.what, said_s=self._clock.now_s())
        state = thing.state if thing.state == "posted" else "open"
        return self._keep(
            thing, said=[*others, word], state="dismissed" if saying.what == "dismissed" else state
        )

    def _params(self, seen: SightReport | SeenThing) -> dict[str, Any]:
        """Parameters of a task about it."""
        return dict(zip(self._fields[seen.kind], (seen.x_m, seen.y_m, seen.photo), strict=True))

    # -- tasks -----------------------------------------------------------------------------------------------

    def _follow(self, thing: SeenThing, task: Mapping[str, Any] | None, undone: bool) -> None:
        if task is None or not self._is_at(task, thing):
            if undone:  # while the index is made anew it lacks tasks, too
                self._keep(thing, state="open", task_id=None)
        elif task["state"] not in LIVE_STATES:
            # What still lies there is reported again.
            self._keep(thing, state="gone")

    def _task_at(self, seen: SightReport) -> int | None:
        """The task that is under way about what lies there, the newest of several."""
        for task in self._live_tasks(seen.kind):
            if self._is_at(task, seen):
                return int(task["id"])
        return None

    def _live_tasks(self, kind: str) -> Iterator[Mapping[str, Any]]:
        offset, total = 0, 1
        while offset < total:
            rows, total = self._tasks.find({"kind": kind}, Page(500, offset), states=LIVE_STATES)
            yield from rows
            offset += 500

    def _is_at(self, task: Mapping[str, Any] | None, seen: SightReport | SeenThing) -> bool:
        if task is None or task["kind"] != seen.kind or seen.kind not in self._fields:
            return False
        x_m, y_m = (task["params"].get(field) for field in self._fields[seen.kind][:2])
        return is_number(x_m) and is_number(y_m) and _apart_m(seen, x_m, y_m) < SAME_PLACE_M

    def _was_left(self, thing: SeenThing) -> bool:
        """Whether a task of the last day about this place ended, and did not take it away."""
        for one in self._things.values():
            near = _apart_m(thing, one.x_m, one.y_m) < SAME_PLACE_M
            if near and one.task_id is not None and thing.first_s - one.last_s < DAY_S:
                task = self._tasks.get(one.task_id)
                if task is None or task["verdict"] != "accepted":
                    return True
        return False

    # -- files -----------------------------------------------------------------------------------------------

    def _thing(self, number: int) -> SeenThing:
        if number not in self._things:
            raise UnknownSeen("there is no such thing", id=number)
        return self._things[number]

    def _keep(self, thing: SeenThing, **changes: Any) -> SeenThing:
        kept = thing.model_copy(update=changes)
        self._folder.mkdir(parents=True, exist_ok=True)
        replace_file(self._folder / f"{kept.id}.json", kept.model_dump_json())
        self._things[kept.id] = kept
        self._changed(kept)
        return kept

    def _forget(self, now_s: float) -> None:
        """Let go of what is gone since yesterday and nobody has spoken of; never of the newest, whose number
        the next one follows."""
        for number in sorted(self._things)[:-1]:
            one = self._things[number]
            if one.state == "gone" and not one.said and now_s - one.last_s > DAY_S:
                (self._folder / f"{number}.json").unlink(missing_ok=True)
                del self._things[number]


def place_fields(kind: Kind) -> list[str]:
    """The parameters of a kind that name a place and its photo: x, y, photo; none where it has not all."""
    named = [name for form in ("map-x", "map-y", "photo") for name in fields(kind, form)[:1]]
    return named if len(named) == 3 else []


def _apart_m(seen: SightReport | SeenThing, x_m: float, y_m: float) -> float:
    return math.hypot(seen.x_m - x_m, seen.y_m - y_m)


def _same_size(one: list[float], other: list[float]) -> bool:
    """Whether both may be extents of one thing, however it lies turned."""
    return all(
        abs(a - b) <= max(_SAME_SIZE_M, _SAME_SIZE * max(a, b))
        for a, b in zip(sorted(one), sorted(other), strict=True)
    )
