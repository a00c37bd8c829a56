"""What a recorder does by itself, on a disk that is full."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

from rodeo.errors import DiskFull
from services.robot_recorder.watch import Watch


class Process:
    """A process whose clock ends it at the second wait."""

    def __init__(self) -> None:
        self.stop, self.told, self.waits = threading.Event(), list[str](), 0
        self.clock = SimpleNamespace(wait_for=self._wait)

    def _wait(self, *_args: Any, **_kwargs: Any) -> None:
        self.waits += 1
        if self.waits == 2:
            self.stop.set()

    def not_ready(self, why: str) -> None:
        self.told.append(why)

    def ready(self) -> None:
        self.told.append("ready")

    def concern(self, *_args: Any) -> None: ...

    def activity(self, text: str, **_details: Any) -> None:
        self.told.append(text)


def test_a_full_disk_does_not_end_what_stops_the_robot() -> None:
    process: Any = Process()
    full = [DiskFull("the disk is full")]
    stopped: list[bool] = []

    def charge_bought() -> None:
        if full:
            raise full.pop()

    standing = SimpleNamespace(stopped=True, charge=True)
    orders: Any = SimpleNamespace(standing=standing, cancelled=lambda _n: False, charge_bought=charge_bought)
    body: Any = SimpleNamespace(emergency_stop=stopped.append, unfit=lambda: "", unknown="", vitals=dict)
    mind: Any = SimpleNamespace(tell=lambda *_a: None, nodes=["/panther1/mind"])
    dao: Any = SimpleNamespace(name="panther1", tasks=lambda **_wanted: [])
    charges: Any = SimpleNamespace(look=lambda: SimpleNamespace(id=3))
    news: Any = SimpleNamespace(wake=threading.Event())
    takes: Any = SimpleNamespace(running=None)
    Watch(process, dao, body, mind, takes, orders, charges, news).run()
    assert stopped == [True, True]
    said = "stopped by an operator"
    assert process.told == [said, "the disk is full", said, "ready"]
