"""The dock's place in the organization: the services that it offers, and the tasks that are its own."""

from __future__ import annotations

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.dao import Assignment, Participant
from rodeo.errors import RemoteError
from rodeo.kinds import providing_energy
from rodeo.site.config import Site
from services.charger.job import Job, is_for


class Assignments:
    """Asks `organization`. Every method raises what the bridge answers."""

    def __init__(self, organization: Participant, site: Site, dock: str) -> None:
        self._organization = organization
        self._site = site
        self._dock = dock
        self._energy = providing_energy(site)
        self._offered_on: tuple[str, str] | None = None
        """Genesis and contract of the chain that the service was offered on."""

    def offer(self) -> None:
        """Once on each chain; on the same one an operator may have changed the offer since.

        One for each dock of the site, in the order of the site file (`dock_offers`): every dock offers them
        all. Done again it changes nothing.
        """
        chain = self._organization.ask(queries.CHAIN)
        here = chain.genesis_hash, chain.contracts.service_manager
        if here == self._offered_on:
            return
        energy = self._energy
        for number, dock in enumerate(self._site.docks):
            self._organization.offer_service(
                energy.name, energy.price_iec, f"charging at {dock.name}", number, energy.judge
            )
        self._offered_on = here

    def offer_again(self) -> None:
        """The next `offer` repeats them: the kind may have another judge."""
        self._offered_on = None

    def standing(self) -> list[tuple[Task, Assignment]]:
        """Tasks that this dock has to do now, the oldest first."""
        return [
            (task, self._organization.assignment(task))
            for task in self._organization.assignments(self._energy.name)
            if is_for(task, self._dock, self._site)
        ]

    def has(self, job: Job) -> bool:
        """Whether the job is of this chain and of the assignment that its task has."""
        if job.assignment != self._organization.assignment(job.task):
            return False
        now = self._task_now(job.task.id)
        # A task that is over ends as always: its proof is submitted, and refused.
        return now is not None and (now.attempt != job.task.attempt or now.nonce in (None, job.task.nonce))

    def stands(self, task: Task) -> bool:
        """Whether the assignment still stands."""
        now = self._task_now(task.id)
        standing = ("assigned", task.attempt, task.nonce)
        return now is not None and (now.state, now.attempt, now.nonce) == standing

    def _task_now(self, task_id: int) -> Task | None:
        """None when the chain has no such task (any more)."""
        try:
            return self._organization.task(task_id)
        except RemoteError as error:
            if error.code != "unknown_task":
                raise
            return None
