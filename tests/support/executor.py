"""panther1 as an executor that submits what a test wants: its recordings come from film."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rodeo.dao import Participant
from rodeo.evidence.store import Store
from rodeo.signing import wallets
from rodeo_kinds.waste_disposal.harness.film import film_cleaning
from rodeo_testing.recordings import Take, Witnesses, later, seal
from tests.support.dao import Dao

PLACE = {"item_id": "item1", "x_m": 4.6, "y_m": 1.2}
"""Where item1 lies by the lab's site file."""


class Film:
    """One film, shown to the organization as if shot anew for each assignment: time does not go back."""

    def __init__(self, dao: Dao) -> None:
        self._take = film_cleaning(dao.site, "item1")
        self._later_s = 0

    def take(self) -> Take:
        self.wait(120)
        return later(self._take, self._later_s)

    def wait(self, seconds: int) -> None:
        """Let this much of the site's time pass before the next."""
        self._later_s += seconds


class Executor:
    """panther1, with whatever proof a test wants it to submit."""

    take: Take

    def __init__(self, dao: Dao, film: Film, folder: Path) -> None:
        self.dao = dao
        self.film = film
        self.folder = folder
        self.wallet = Participant(dao.running.bus, dao.site.org, "panther1")
        self.device = wallets.load(dao.site, "panther1-device")
        self.witnesses = Witnesses(
            mocap=wallets.load(dao.site, "mocap-device"),
            bin=wallets.load(dao.site, "itrash-device"),
            robot=self.device,
        )
        self.store = Store(dao.site)

    def assigned(self, **task: Any) -> int:
        """A task that this robot has to do, posted just before the film begins."""
        self.take = self.film.take()
        self.dao.set_clock(self.take.start_s - 5)
        return self.dao.post(params=PLACE, **task)

    def record(self, task_id: int) -> Path:
        task = self.wallet.task(task_id)
        path = self.folder / f"{task_id}-{task.attempt}.mcap"
        seal(self.take, path, self.wallet.binding(task, "panther1"), self.device, self.witnesses)
        self.dao.set_clock(self.take.end_s + 5)
        return path

    def submit(self, task_id: int, sha256: str, uri: str) -> int:
        """Submit for the running attempt, which is returned."""
        attempt = self.wallet.task(task_id).attempt
        self.wallet.submit_proof(task_id, attempt, sha256, uri)
        return attempt

    def give_back(self) -> None:
        """What a test that failed has left undone: the next one needs the robot's services."""
        while left := self.wallet.assignments("waste_disposal"):
            self.wallet.abandon_task(left[0])

    def verdict(self, task_id: int, attempt: int) -> dict[str, Any]:
        """The first `verdict` on this attempt, undecided where it was passed on, with the arguments of its
        events."""
        told = ("PassedOn", "Reported", "Ruled")

        def said() -> dict[str, dict[str, Any]]:
            of_task = [one for one in self.dao.events if one.task_id == task_id and one.name in told]
            ruled = {one.tx_hash for one in of_task if one.args.get("attempt") == attempt}
            return {one.name: one.args for one in reversed(of_task) if one.tx_hash in ruled}

        self.dao.wait_for(lambda: "Ruled" in said(), f"a verdict on task {task_id} attempt {attempt}")
        found = said()
        verdict = "undecided" if "PassedOn" in found else found["Ruled"]["ruling"]
        return {**found.get("Reported", {}), **found["Ruled"], "verdict": verdict}


def stored(executor: Executor, task_id: int) -> tuple[str, str]:
    """Hash and URI of an honest proof."""
    uri = executor.store.put(executor.record(task_id))
    return Store.hash_of(uri), uri
