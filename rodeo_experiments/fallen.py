"""What the bin signed about things that nobody listed, read from the proofs that were accepted."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from rodeo.bus.messages import Task
from rodeo.evidence.store import Store
from rodeo.robot.recording import recording_of, statements
from rodeo.site.config import Site
from rodeo.witness.statement import Classification, Drop
from rodeo_experiments.record import Arrival, Fallen


def with_fallen(site: Site, arrivals: Sequence[Arrival], tasks: Sequence[Task]) -> list[Arrival]:
    """The arrivals, with what the bin signed about the things that nobody listed. Raises EvidenceError."""
    unlisted = {thing.id for thing in site.things}
    paid = {task.id: task for task in tasks if task.state == "settled" and task.verdict == "accepted"}
    return [
        arrival.model_copy(update={"fallen": _fallen(site, paid[arrival.task_id])})
        if arrival.item in unlisted and arrival.task_id in paid
        else arrival
        for arrival in arrivals
    ]


def _fallen(site: Site, task: Task) -> Fallen | None:
    """None where an accepted proof of another kind tells of no drop."""
    with tempfile.TemporaryDirectory() as folder:
        path = Store(site).fetch(task.proof_uri or "", task.proof_sha256 or "", folder=Path(folder))
        own, said = recording_of(path), [one for _, one in statements(path)]
    drops = [one for one in said if isinstance(one, Drop) and own in [by.recording for by in one.claimants]]
    if not drops:
        return None
    shown = {one.number: one.item_class for one in said if isinstance(one, Classification)}
    return Fallen(
        item_class=shown.get(drops[-1].classification or 0, "unknown"),
        weight_n=drops[-1].weight_n,
        time_s=drops[-1].settled_s,
    )
