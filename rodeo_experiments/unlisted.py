"""What became of things that nobody listed: who found them, and what the bin made of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from rodeo.bus.messages import Task
from rodeo.lab.config import ItemConfig
from rodeo_experiments.record import Arrival, Run

_G_M_S2 = 9.81
COLUMNS = (
    "thing",
    "mass (g)",
    "left",
    "found by a robot",
    "pointed at",
    "never posted",
    "in the bin",
    "the bin's class",
    "its scale (g)",
)


@dataclass(frozen=True)
class Left:
    """A thing that was left on the floor, and how that ended."""

    arrival: Arrival
    thing: ItemConfig
    task: Task | None

    @property
    def end(self) -> str:
        return "never posted" if self.task is None else self.task.verdict or self.task.state

    @property
    def posted_min(self) -> float:
        """From being left to its task, min of site time. Blocks have whole seconds: never less than 0."""
        assert self.task is not None
        return max(0.0, self.task.registered - self.arrival.time_s) / 60

    @property
    def in_bin_min(self) -> float:
        """From being left to lying in the bin, min of site time."""
        assert self.arrival.fallen is not None
        return (self.arrival.fallen.time_s - self.arrival.time_s) / 60

    @property
    def scale_g(self) -> float:
        """Mass by the bin's scale."""
        assert self.arrival.fallen is not None
        return self.arrival.fallen.weight_n / _G_M_S2 * 1000

    @property
    def off_g(self) -> float:
        """The scale's error."""
        return abs(self.scale_g - self.thing.mass_kg * 1000)

    @property
    def is_known(self) -> bool:
        """Whether the bin named its class."""
        assert self.arrival.fallen is not None
        return self.arrival.fallen.item_class == self.thing.item_class


@dataclass(frozen=True)
class Unlisted:
    """All that was left in a run and that nobody listed."""

    run: Run

    @cached_property
    def left(self) -> list[Left]:
        things, tasks = {one.id: one for one in self.run.things}, {one.id: one for one in self.run.tasks}
        return [
            Left(one, things[one.item], None if one.task_id is None else tasks[one.task_id])
            for one in self.run.arrivals
            if one.item in things
        ]

    @property
    def found(self) -> list[Left]:
        """Those that robots found."""
        return [one for one in self.left if one.arrival.found_by is not None]

    @property
    def pointed(self) -> list[Left]:
        """Those that a person posted."""
        return [one for one in self.left if one.task is not None and one.arrival.found_by is None]

    @property
    def fallen(self) -> list[Left]:
        """Those in the bin."""
        return [one for one in self.left if one.arrival.fallen is not None]

    @property
    def about_nothing(self) -> int:
        """Tasks about places where nothing was left."""
        meant = {one.task_id for one in self.run.arrivals}
        return sum(one.id not in meant for one in self.run.of(self.run.work))

    def rows(self) -> Iterator[tuple[str, ...]]:
        """A line for each thing, by COLUMNS."""
        for thing in self.run.things:
            some = Unlisted(self.run.model_copy(update={"things": [thing]}))
            classes = Counter(one.arrival.fallen.item_class for one in some.fallen if one.arrival.fallen)
            shown_g = [one.scale_g for one in some.fallen]
            yield (
                f"{thing.id}, {thing.item_class} {thing.shape}",
                f"{thing.mass_kg * 1000:g}",
                *(str(len(each)) for each in (some.left, some.found, some.pointed)),
                str(sum(one.task is None for one in some.left)),
                str(len(some.fallen)),
                ", ".join(f"{name} {number}" for name, number in classes.most_common()),
                f"{min(shown_g):.0f} to {max(shown_g):.0f}" if shown_g else "",
            )
