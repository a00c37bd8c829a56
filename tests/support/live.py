"""An organization whose robots work by themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Any

from rodeo.bus.messages import DaoEvent, Status
from rodeo.host.clock import WallClock
from rodeo.lab.world import begin, build_world
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo.site.processes import processes_of
from rodeo_testing.waiting import HANG_S
from tests.support.dao import Dao
from tests.support.site import RunningSite


class LiveDao(Dao):
    """Hears also what robots do on `running`, whose bridge is ready."""

    def __init__(self, running: RunningSite, wait_s: float = HANG_S) -> None:
        super().__init__(running)
        self._wait_s = wait_s
        self.activities: list[str] = []
        self.listen()
        status = topics.STATUS.name(org=self.site.org, process="robot_agent")
        running.bus.subscribe_json(status, self._on_status)

    def _on_status(self, _key: str, data: dict[str, Any]) -> None:
        with self._changed:
            self.activities.append(Status.model_validate(data).activity)
            self._changed.notify_all()

    def wait_for_event(self, name: str, task_id: int) -> DaoEvent:
        def found() -> DaoEvent | None:
            return next((e for e in self.events if (e.name, e.task_id) == (name, task_id)), None)

        return self._wait(found, f"{name} of task {task_id}")

    def wait_for_activity(self, text: str) -> None:
        self._wait(lambda: any(text in activity for activity in self.activities), text)

    def _wait(self, found: Callable[[], Any], what: str) -> Any:
        with self._changed:
            assert self._changed.wait_for(found, self._wait_s), (
                f"waited for {what}; events: {[(one.name, one.task_id) for one in self.events]}\n"
                f"the oracle said:\n{self.running.log('oracle', 2_000)}\n"
                f"the agent said:\n{self.running.log('robot_agent')}"
            )
            return found()

    def clean(self, item_id: str, **more: Any) -> int:
        """Post the cleaning of an item where the site has it; the task's id."""
        place = {item.id: item.pose for item in self.site.items}.get(item_id)
        params = {"item_id": item_id, "x_m": place.x_m if place else 1.0, "y_m": place.y_m if place else 1.0}
        return self.post(**{"params": params, **more})

    def lay(self, item_id: str) -> None:
        """Put the item where the site has it, wherever an earlier attempt at the same test has left it."""
        model = build_world(self.site)
        lying = begin(model, self.site).body(item_id)
        state = types.new("simulation_interfaces/msg/EntityState")
        at, turn = state.pose.position, state.pose.orientation
        at.x, at.y, at.z = map(float, lying.xpos)
        turn.w, turn.x, turn.y, turn.z = map(float, lying.xquat)
        node = Node(self.running.bus.session, "test", "", self.site.bus.domain_id, WallClock())
        client = node.client(topics.SET_ENTITY_STATE.name(), topics.SET_ENTITY_STATE.type)
        assert client.wait_for_server(HANG_S)
        request = types.new(f"{topics.SET_ENTITY_STATE.type}_Request", entity=item_id, state=state)
        assert client.call(request, HANG_S).result.result == 1
        node.close()

    def cancel(self, task_id: int) -> None:
        self.command("organization", "cancel_task", task_id=task_id)

    def balances_iec(self) -> dict[str, Decimal]:
        """Participant -> IEC, exactly."""
        return {one["name"]: Decimal(one["balance_iec"]) for one in self.state("wallets")["wallets"]}


@contextmanager
def living(path: Path, *processes: str, wait_s: float = HANG_S) -> Iterator[LiveDao]:
    """A site on which an organization was founded and these processes run; all of them if none is named."""
    with RunningSite(path) as running:
        running.start_founded(*(processes or (process.name for process in processes_of(running.site))))
        with closing(LiveDao(running, wait_s)) as organization:
            yield organization
