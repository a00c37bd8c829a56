"""The bin's state machine under simulated time: what it does with what its sensors say."""

from __future__ import annotations

import math

import pytest

from rodeo.lab.config import BinConfig, ItemClass, Pose2
from rodeo.lab.drop import WATCHED_S
from rodeo.vision.classification import UNKNOWN, Classification
from rodeo.witness.statement import Claimant
from services.itrash.behaviour import (
    Action,
    Attest,
    Bin,
    ClassificationRecord,
    DropRecord,
    Memory,
    Record,
    RemovalRecord,
    State,
    TakePhoto,
    WatchRecord,
)

CONFIG = BinConfig(pose=Pose2(x_m=0.0, y_m=0.0))
SHOWN_M = 0.34
SHA = "0x" + "ab" * 32


def verdict(label: str) -> Classification:
    return Classification(label, {"plastic": 0.9, "paper": 0.1})


def seen(plastic: float, item: float = 1.0) -> Classification:
    """What the network makes of a picture that is plastic with this probability, if it shows an item."""
    probabilities = {"plastic": plastic, "paper": 1 - plastic}
    best = max(probabilities, key=probabilities.__getitem__)
    sure = probabilities[best] * item >= 0.5
    return Classification(best if sure else UNKNOWN, probabilities, item, unknown_below=0.5)


class Bench:
    """A bin on a bench: sensors at 10 Hz, a camera that answers at once."""

    def __init__(self, memory: Memory | None = None, config: BinConfig = CONFIG) -> None:
        self.bin = Bin(config, memory or Memory())
        self.time_s = 1000.0
        self.labels: list[str | None] = []
        """What the classifier will say, one after another; None for a camera that fails."""
        self.loads_n = dict.fromkeys(CONFIG.compartments, 0.0)
        self.silent: set[str] = set()
        """Compartments whose load cells say nothing."""
        self.attested: list[Record] = []
        self.watches: list[WatchRecord] = []
        self.photos = 0

    def run(self, seconds: float, range_m: float = math.inf, move_m: float = 0.0) -> None:
        for _ in range(round(seconds * 10)):
            self.time_s = round(self.time_s + 0.1, 6)
            range_m += move_m
            self._do(self.bin.presence(range_m, self.time_s))
            for compartment, force_n in self.loads_n.items():
                if compartment in self.silent:
                    continue
                self._do(self.bin.load(compartment, force_n, self.time_s))

    def keep(self, record: Record) -> None:
        """Watches apart: they come a while after every drop."""
        if isinstance(record, WatchRecord):
            self.watches.append(record)
        else:
            self.attested.append(record)

    def drop(self, compartment: str, weight_n: float = 0.3) -> None:
        self.loads_n[compartment] += weight_n

    def _do(self, actions: list[Action]) -> None:
        for action in actions:
            if isinstance(action, Attest):
                self.keep(action.record)
            else:
                assert action == TakePhoto(self.time_s)
                self.photos += 1
                label = self.labels.pop(0)
                if label is None:
                    self._do(self.bin.photo_failed(self.time_s))
                else:
                    self._do(self.bin.photo(verdict(label), SHA, self.time_s))


def shown(*labels: str | None) -> Bench:
    """A bin that has looked at an item and waits for it."""
    bench = Bench()
    bench.run(2.0)
    bench.labels = list(labels)
    bench.run(5.0, SHOWN_M)
    return bench


def test_a_shown_item_is_classified_once_and_its_drop_confirmed() -> None:
    bench = shown("plastic")
    assert bench.bin.state is State.AWAITING_DROP
    (classified,) = bench.attested
    assert isinstance(classified, ClassificationRecord)
    assert (classified.item_class, classified.compartment, classified.number) == ("plastic", "yellow", 1)
    assert classified.model_dump()["class"] == "plastic"
    assert classified.image_sha256 == SHA

    bench.run(3.0)
    bench.drop("yellow")
    bench.run(1.5)
    disposed = bench.attested[-1]
    assert isinstance(disposed, DropRecord)
    assert disposed.correct
    assert disposed.classification == 1
    assert disposed.weight_n == 0.3
    bench.run(1.5)
    assert bench.bin.state is State.IDLE


def test_what_a_mistake_costs_decides_where_it_goes() -> None:
    costs = {ItemClass.PAPER: {"yellow": 20.0}}
    bench = Bench(config=CONFIG.model_copy(update={"costs": costs}))
    bench.run(2.0)
    bench.labels = ["plastic"]  # one in ten is paper that looks like it
    bench.run(5.0, SHOWN_M)
    (classified,) = bench.attested
    assert isinstance(classified, ClassificationRecord)
    assert (classified.item_class, classified.compartment) == ("plastic", "blue")


def test_the_wrong_compartment_is_attested_as_such() -> None:
    bench = shown("glass")
    bench.drop("grey")
    bench.run(1.5, SHOWN_M)
    disposed = bench.attested[-1]
    assert isinstance(disposed, DropRecord)
    assert (disposed.compartment, disposed.expected_compartment) == ("grey", "green")
    assert not disposed.correct
    assert bench.bin.state is State.WRONG_COMPARTMENT


def test_a_moving_item_is_not_photographed() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.run(2.0, 0.5, move_m=-0.01)
    assert (bench.photos, bench.bin.state) == (0, State.ITEM_SEEN)


def test_something_that_only_passes_leaves_the_bin_idle() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.run(0.2, SHOWN_M)
    bench.run(1.0)
    assert (bench.photos, bench.bin.state) == (0, State.IDLE)


def test_what_is_farther_than_the_presence_range_is_not_an_item() -> None:
    bench = Bench()
    bench.run(3.0, CONFIG.presence_range_m + 0.01)
    assert bench.photos == 0


def test_an_unsure_photo_is_taken_again_before_the_item_is_called_unknown() -> None:
    bench = shown(UNKNOWN, "metal")
    (classified,) = bench.attested
    assert isinstance(classified, ClassificationRecord)
    assert classified.item_class == "metal"

    bench = shown(UNKNOWN, UNKNOWN, UNKNOWN)
    (classified,) = bench.attested
    assert isinstance(classified, ClassificationRecord)
    assert (classified.item_class, classified.compartment) == (UNKNOWN, "grey")


def test_a_camera_that_fails_is_asked_again() -> None:
    bench = shown(None, None, "paper")
    (classified,) = bench.attested
    assert isinstance(classified, ClassificationRecord)
    assert classified.item_class == "paper"
    assert bench.photos == 3


def test_showing_the_item_again_gives_a_new_classification() -> None:
    bench = shown("plastic")
    bench.run(2.0)
    bench.labels = ["glass"]
    bench.run(2.0, SHOWN_M)
    bench.drop("green")
    bench.run(1.5)
    disposed = bench.attested[-1]
    assert isinstance(disposed, DropRecord)
    assert (disposed.classification, disposed.correct) == (2, True)


def test_another_view_of_what_was_unknown_is_believed_and_attested_anew() -> None:
    bench = shown(*[UNKNOWN] * 3)
    bench.run(2.0)
    bench.labels = ["glass"]
    bench.run(2.0, SHOWN_M)
    assert [record.model_dump().get("class") for record in bench.attested] == [UNKNOWN, "glass"]


def test_what_stays_unknown_from_another_side_is_said_again() -> None:
    bench = shown(*[UNKNOWN] * 3)
    bench.run(2.0)
    bench.labels = [UNKNOWN] * 3
    bench.run(3.0, SHOWN_M)
    assert [record.number for record in bench.attested] == [1, 2]
    assert bench.bin.state is State.AWAITING_DROP


def test_a_full_compartment_accepts_nothing_until_it_was_emptied() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.drop("yellow", CONFIG.full_at_n)
    bench.run(2.0)
    assert bench.bin.fill["yellow"] == pytest.approx(1.0)
    bench.labels = ["plastic", "glass", "plastic"]
    bench.run(2.0, SHOWN_M)
    refused = bench.attested[-1]
    assert isinstance(refused, ClassificationRecord)
    assert (refused.compartment, refused.full) == ("yellow", True)
    assert bench.bin.state is State.FULL

    bench.run(3.0)
    bench.run(2.0, SHOWN_M)
    other = bench.attested[-1]
    assert isinstance(other, ClassificationRecord)
    assert (other.compartment, other.full, bench.bin.state) == ("green", False, State.AWAITING_DROP)
    bench.drop("green")
    bench.run(4.0)

    bench.drop("yellow", -CONFIG.full_at_n)
    bench.run(2.0)
    bench.run(2.0, SHOWN_M)
    accepted = bench.attested[-1]
    assert isinstance(accepted, ClassificationRecord)
    assert (accepted.compartment, accepted.full) == ("yellow", False)


def test_a_drop_into_a_full_compartment_is_attested_as_not_correct() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.drop("yellow", CONFIG.full_at_n)
    bench.run(2.0)
    bench.labels = ["plastic"]
    bench.run(2.0, SHOWN_M)
    bench.drop("yellow")
    bench.run(2.0)
    disposed = bench.attested[-1]
    assert isinstance(disposed, DropRecord)
    assert (disposed.classification, disposed.correct) == (None, False)


def test_robots_and_people_are_served_one_after_another() -> None:
    bench = Bench()
    bench.run(1.0)
    for label, compartment in (
        ("plastic", "yellow"),
        ("paper", "blue"),
        ("glass", "green"),
        ("trash", "grey"),
    ):
        bench.labels = [label]
        bench.run(3.0, SHOWN_M)
        bench.run(2.0)
        bench.drop(compartment)
        bench.run(4.0)
    drops = [record for record in bench.attested if isinstance(record, DropRecord)]
    assert [(drop.classification, drop.correct) for drop in drops] == [(n, True) for n in (1, 2, 3, 4)]


def test_an_empty_gripper_in_view_does_not_take_a_classification_back() -> None:
    bench = shown("plastic")
    bench.run(2.0)
    bench.labels = [UNKNOWN] * 3
    bench.run(3.0, SHOWN_M)
    assert bench.bin.state is State.AWAITING_DROP
    assert len(bench.attested) == 1


def test_a_gripper_that_is_taken_for_an_item_while_its_own_falls_is_not_what_fell() -> None:
    bench = shown("plastic")
    bench.run(2.0)
    bench.labels = ["metal"]
    bench.run(0.3, SHOWN_M)
    bench.drop("yellow")
    bench.run(2.0, SHOWN_M)
    first, second, drop = bench.attested
    assert isinstance(first, ClassificationRecord)
    assert isinstance(second, ClassificationRecord)
    assert isinstance(drop, DropRecord)
    assert drop.after_s < second.shown_s < drop.settled_s
    assert (drop.classification, drop.correct) == (first.number, True)


def test_an_unknown_item_long_after_a_classified_one_is_another_and_is_said_to_be_unknown() -> None:
    bench = shown("plastic")
    bench.run(70.0)
    bench.labels = [UNKNOWN] * 3
    bench.run(3.0, SHOWN_M)
    assert [record.model_dump().get("class") for record in bench.attested] == ["plastic", UNKNOWN]


def test_looking_again_and_again_does_not_put_the_time_out_off() -> None:
    bench = shown("plastic")
    for _ in range(10):
        bench.run(14.0)
        bench.labels = [UNKNOWN] * 3
        bench.run(3.0, SHOWN_M)
    assert bench.bin.memory.pending is not None
    bench.run(20.0)
    assert bench.bin.memory.pending is None


def test_the_bin_says_once_after_each_drop_that_it_was_there() -> None:
    """Also after a restart, and if nobody had shown what fell."""
    bench = shown("plastic")
    bench.drop("yellow")
    bench.run(5.0)
    bench.drop("blue")
    bench.run(WATCHED_S - 5.0)
    assert bench.watches == []
    bench.bin = Bin(CONFIG, Memory.model_validate_json(bench.bin.memory.model_dump_json()))
    bench.run(60.0)
    assert [(one.drop, one.compartment) for one in bench.watches] == [(1, "yellow"), (2, "blue")]
    assert all(one.until_s - one.after_s == pytest.approx(WATCHED_S) for one in bench.watches)
    fell = [record.settled_s for record in bench.attested if isinstance(record, DropRecord)]
    assert [one.after_s for one in bench.watches] == fell


def test_what_was_decided_is_remembered_until_it_is_signed() -> None:
    bench = shown("plastic")
    bench.drop("yellow")
    bench.run(1.5)
    remembered = Memory.model_validate_json(bench.bin.memory.model_dump_json()).unsigned
    assert remembered == bench.attested
    assert [type(record) for record in remembered] == [ClassificationRecord, DropRecord]


def test_an_arm_that_swings_through_the_view_is_not_a_new_item() -> None:
    bench = shown("plastic")
    bench.run(0.5)
    bench.run(2.0, SHOWN_M)
    assert bench.photos == 1


def test_a_gripper_that_draws_back_after_the_drop_is_not_a_new_item() -> None:
    bench = shown("plastic")
    bench.run(5.0)
    bench.drop("yellow")
    bench.run(2.0)
    bench.run(2.0, SHOWN_M)
    assert (bench.photos, bench.bin.state) == (1, State.CONFIRMED)
    bench.run(2.5)
    bench.labels = ["paper"]
    bench.run(2.0, SHOWN_M)
    assert bench.attested[-1].number == 2


def test_a_drop_that_never_comes_times_out_and_the_bin_is_free_again() -> None:
    bench = shown("plastic")
    bench.run(200.0)
    assert bench.bin.state is State.IDLE
    bench.labels = ["paper"]
    bench.run(2.0, SHOWN_M)
    assert bench.bin.state is State.AWAITING_DROP
    assert bench.attested[-1].number == 2


def test_what_falls_in_without_being_shown_is_attested_as_not_correct() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.drop("blue", 1.5)
    bench.run(1.5)
    (disposed,) = bench.attested
    assert isinstance(disposed, DropRecord)
    assert (disposed.classification, disposed.expected_compartment) == (None, None)
    assert not disposed.correct
    assert bench.bin.state is State.IDLE


def test_emptying_a_compartment_is_not_a_disposal() -> None:
    bench = Bench()
    bench.loads_n["blue"] = 20.0
    bench.run(1.0)
    bench.loads_n["blue"] = 0.0
    bench.run(2.0)
    assert [type(record) for record in bench.attested] == [RemovalRecord]


def test_one_drop_is_one_disposal() -> None:
    bench = shown("plastic")
    bench.drop("yellow")
    bench.run(30.0)
    assert sum(isinstance(record, DropRecord) for record in bench.attested) == 1


def disposals(bench: Bench) -> list[DropRecord]:
    return [record for record in bench.attested if isinstance(record, DropRecord)]


@pytest.mark.parametrize("lead_s", [-0.3, 0.0, 0.3])
def test_what_a_fall_shakes_in_other_compartments_is_no_drop(lead_s: float) -> None:
    bench = shown("plastic")
    first, second = sorted([(0.0, "yellow", 0.3), (lead_s, "blue", 0.12)])
    bench.drop(first[1], first[2])
    bench.run(second[0] - first[0])
    bench.drop(second[1], second[2])
    bench.run(3.0)
    (disposed,) = disposals(bench)
    assert (disposed.compartment, disposed.weight_n, disposed.correct) == ("yellow", 0.3, True)


def test_a_push_that_does_not_stay_is_no_drop() -> None:
    bench = shown("plastic")
    bench.drop("green", 4.0)
    bench.run(0.9)
    bench.drop("green", -4.0)
    bench.run(2.0)
    assert disposals(bench) == []
    bench.drop("yellow")
    bench.run(1.5)
    (disposed,) = disposals(bench)
    assert disposed.correct


def test_a_push_that_does_not_stay_does_not_hide_a_drop() -> None:
    bench = shown("plastic")
    bench.drop("yellow")
    bench.run(0.3)
    bench.drop("green", 4.0)
    bench.run(0.9)
    bench.drop("green", -4.0)
    bench.run(2.0)
    (disposed,) = disposals(bench)
    assert (disposed.compartment, disposed.correct) == ("yellow", True)


def test_a_compartment_that_is_lifted_for_a_moment_is_not_emptied() -> None:
    bench = Bench()
    bench.loads_n["blue"] = 20.0
    bench.run(1.0)
    bench.drop("blue", -20.0)
    bench.run(0.9)
    bench.drop("blue", 20.0)
    bench.run(2.0)
    assert bench.attested == []


def test_a_restart_while_a_step_is_watched_still_sees_it() -> None:
    bench = shown("plastic")
    bench.drop("yellow")
    bench.run(0.8)
    assert disposals(bench) == []
    restarted = Bench(Memory.model_validate_json(bench.bin.memory.model_dump_json()))
    restarted.time_s, restarted.loads_n = bench.time_s, bench.loads_n
    restarted.run(1.5)
    (disposed,) = disposals(restarted)
    assert disposed.correct


def test_a_restart_while_waiting_still_confirms_a_drop_that_happened_meanwhile() -> None:
    bench = shown("plastic")
    restarted = Bench(Memory.model_validate_json(bench.bin.memory.model_dump_json()))
    restarted.time_s = bench.time_s + 20.0
    restarted.drop("yellow")
    restarted.run(1.5)
    (disposed,) = restarted.attested
    assert isinstance(disposed, DropRecord)
    assert (disposed.classification, disposed.correct) == (1, True)


@pytest.mark.parametrize("state", [State.ITEM_SEEN, State.CLASSIFYING])
def test_a_restart_while_looking_looks_again(state: State) -> None:
    restarted = Bench(Memory(state=state))
    assert restarted.bin.state is State.IDLE
    restarted.labels = ["paper"]
    restarted.run(2.0, SHOWN_M)
    assert restarted.bin.state is State.AWAITING_DROP
    assert restarted.photos == 1


def test_a_photo_that_comes_after_the_drop_changes_nothing() -> None:
    bench = Bench()
    assert bench.bin.photo(verdict("paper"), SHA, 1.0) == []
    assert bench.bin.state is State.IDLE


# -- what fell while nobody looked ---------------------------------------------------------------------


def restarted(bench: Bench, down_s: float) -> Bench:
    """The same bin after a restart: what it remembers and where its sensors are."""
    again = Bench(Memory.model_validate_json(bench.bin.memory.model_dump_json()))
    again.time_s, again.loads_n = bench.time_s + down_s, bench.loads_n
    return again


def test_a_drop_during_a_downtime_longer_than_the_time_out_belongs_to_what_was_shown() -> None:
    bench = restarted(shown("plastic"), down_s=500.0)
    bench.drop("yellow")
    bench.run(3.0)
    (disposed,) = disposals(bench)
    assert (disposed.classification, disposed.correct) == (1, True)


def test_the_sensors_falling_silent_is_like_a_restart() -> None:
    bench = shown("plastic")
    bench.time_s += 500.0
    bench.drop("yellow")
    bench.run(3.0)
    (disposed,) = disposals(bench)
    assert (disposed.classification, disposed.correct) == (1, True)


def test_a_downtime_without_a_drop_ends_in_the_time_out() -> None:
    bench = restarted(shown("plastic"), down_s=500.0)
    bench.run(1.0)
    assert bench.bin.memory.pending is None


@pytest.mark.parametrize(("after_s", "seq"), [(179.5, 1), (180.5, None)])
def test_a_drop_belongs_to_what_was_shown_if_it_fell_before_the_time_out(
    after_s: float, seq: int | None
) -> None:
    bench = shown("plastic")
    assert bench.bin.memory.pending is not None
    bench.run(bench.bin.memory.pending.shown_s + after_s - bench.time_s)
    bench.drop("yellow")
    bench.run(3.0)
    (disposed,) = disposals(bench)
    assert disposed.classification == seq


def test_a_drop_that_fell_after_the_time_out_is_not_what_was_shown_though_the_bin_still_waits() -> None:
    bench = shown("plastic")
    bench.silent = {"grey"}
    bench.run(180.0)
    bench.drop("yellow")
    bench.run(2.0)
    (disposed,) = disposals(bench)
    assert disposed.classification is None


@pytest.mark.parametrize("down_s", [None, 500.0])
def test_a_load_cell_that_says_nothing_does_not_put_the_time_out_off_for_ever(down_s: float | None) -> None:
    bench = shown("plastic")
    if down_s is None:
        bench.run(170.0)
    else:
        bench = restarted(bench, down_s)
    bench.silent = {"grey"}
    bench.run(25.0)
    assert bench.bin.memory.pending is None


@pytest.mark.parametrize("down_s", [20.0, 500.0])
def test_a_drop_during_a_downtime_is_told_though_another_load_cell_says_nothing(down_s: float) -> None:
    bench = restarted(shown("plastic"), down_s)
    bench.drop("blue")
    bench.silent = {"yellow"}
    bench.run(8.0)
    (disposed,) = disposals(bench)
    assert (disposed.classification, disposed.correct) == (1, False)


def test_each_of_two_drops_during_a_downtime_is_attested() -> None:
    bench = restarted(shown("plastic"), down_s=20.0)
    bench.drop("yellow", 0.3)
    bench.drop("blue", 0.5)
    bench.run(2.0)
    assert [(d.compartment, d.weight_n, d.classification, d.correct) for d in disposals(bench)] == [
        ("blue", 0.5, None, False),
        ("yellow", 0.3, 1, True),
    ]
    assert bench.bin.state is State.CONFIRMED
    assert len({drop.settled_s for drop in disposals(bench)}) == 1  # or the later word would be the older one


def test_of_drops_during_a_downtime_the_matching_one_is_waited_for() -> None:
    bench = restarted(shown("plastic"), down_s=20.0)
    bench.drop("yellow", 0.3)
    bench.drop("blue", 0.5)
    bench.silent = {"yellow"}
    bench.run(3.0)
    bench.silent = set()
    bench.run(3.0)
    owners = [(d.compartment, d.classification) for d in disposals(bench)]
    assert owners == [("blue", None), ("yellow", 1)]


def test_load_cells_that_were_silent_together_tell_each_drop_and_the_matching_one_last() -> None:
    bench = shown("plastic")
    bench.silent = set(CONFIG.compartments)
    bench.run(20.0)
    bench.drop("yellow", 0.3)
    bench.drop("blue", 0.5)
    bench.silent = set()
    bench.run(2.0)
    owners = [(d.compartment, d.classification) for d in disposals(bench)]
    assert owners == [("blue", None), ("yellow", 1)]


@pytest.mark.parametrize("quiet_s", [0.0, 20.0])
def test_a_load_cell_that_falls_silent_during_a_step_does_not_keep_the_others_from_telling(
    quiet_s: float,
) -> None:
    bench = shown("plastic")
    bench.drop("grey", 5.0)
    bench.run(0.8)
    bench.silent = {"grey"}
    bench.run(6.0)
    bench.silent = set(CONFIG.compartments)
    bench.run(quiet_s)
    bench.silent = {"grey"}
    bench.drop("yellow")
    bench.run(2.0)
    (disposed,) = disposals(bench)
    assert (disposed.compartment, disposed.correct) == ("yellow", True)


def test_of_drops_during_a_downtime_that_do_not_match_the_largest_is_what_was_shown() -> None:
    bench = restarted(shown("plastic"), down_s=20.0)
    bench.drop("grey", 0.3)
    bench.drop("blue", 0.5)
    bench.run(2.0)
    assert [(d.compartment, d.classification) for d in disposals(bench)] == [("grey", None), ("blue", 1)]
    assert bench.bin.state is State.WRONG_COMPARTMENT


def test_a_drop_during_a_downtime_is_not_swallowed_by_one_that_is_seen() -> None:
    bench = Bench()
    bench.run(2.0)
    bench.silent = {"blue"}
    bench.run(20.0)
    bench.drop("blue", 0.3)
    bench.silent = set()
    bench.drop("yellow", 0.5)
    bench.run(3.0)
    assert {(d.compartment, d.weight_n) for d in disposals(bench)} == {("blue", 0.3), ("yellow", 0.5)}


def test_a_drop_during_a_downtime_is_told_before_what_is_in_view_is_looked_at() -> None:
    bench = restarted(shown("plastic"), down_s=20.0)
    bench.bin.memory.state = State.ITEM_SEEN
    bench = restarted(bench, down_s=0.0)
    bench.drop("yellow")
    bench.labels = ["glass"]
    bench.run(3.0, SHOWN_M)
    (disposed,) = disposals(bench)
    assert (disposed.classification, disposed.correct) == (1, True)
    assert bench.photos == 0


# -- compartments that are lifted out ------------------------------------------------------------------


def filled(weight_n: float = 20.0) -> Bench:
    bench = Bench()
    bench.loads_n["blue"] = weight_n
    bench.run(2.0)
    return bench


@pytest.mark.parametrize("back_n", [0.0, 12.0, 20.0, 20.05])
def test_a_compartment_that_is_lifted_out_and_put_back_is_no_drop(back_n: float) -> None:
    bench = filled()
    for force_n in (-6.0, -5.5, back_n):
        bench.loads_n["blue"] = force_n
        bench.run(5.0)
    (removed,) = bench.attested
    assert isinstance(removed, RemovalRecord)
    assert bench.bin.loads_n["blue"] == pytest.approx(back_n)
    bench.drop("blue")
    bench.run(2.0)
    (disposed,) = disposals(bench)
    assert disposed.weight_n == 0.3


def test_what_is_put_back_with_more_than_it_held_counts_by_that() -> None:
    bench = filled()
    bench.loads_n["blue"] = -6.0
    bench.run(5.0)
    bench = restarted(bench, down_s=20.0)
    bench.loads_n["blue"] = 21.5
    bench.run(2.0)
    (disposed,) = disposals(bench)
    assert disposed.weight_n == 1.5


def test_putting_an_emptied_compartment_back_does_not_confirm_what_was_shown() -> None:
    bench = shown("plastic")
    bench.loads_n["yellow"] = -6.0
    bench.run(5.0)
    bench.loads_n["yellow"] = 0.0
    bench.run(2.0)
    assert disposals(bench) == []
    assert bench.bin.state is State.AWAITING_DROP


# -- what is held in view ------------------------------------------------------------------------------


@pytest.mark.parametrize(("compartment", "view"), [("yellow", math.inf), ("grey", SHOWN_M)])
def test_what_is_held_in_view_after_a_drop_is_looked_at(compartment: str, view: float) -> None:
    bench = shown("plastic")
    bench.drop(compartment)
    bench.run(2.0, view)
    bench.labels = ["glass"]
    bench.run(3.5, SHOWN_M + 0.05)
    assert bench.photos == 1
    bench.run(1.5, SHOWN_M + 0.05)
    assert bench.attested[-1].model_dump()["class"] == "glass"
    assert bench.bin.state is State.AWAITING_DROP


def test_a_gripper_that_holds_still_after_its_drop_is_not_looked_at() -> None:
    bench = shown("plastic")
    bench.drop("yellow")
    bench.run(60.0, SHOWN_M)
    assert (bench.photos, bench.bin.state) == (1, State.CONFIRMED)


def test_what_is_unknown_and_stands_in_view_after_a_drop_is_looked_at_once_and_not_told() -> None:
    bench = shown("plastic")
    bench.drop("yellow")
    bench.run(2.0)
    bench.labels = [UNKNOWN] * 3
    bench.run(60.0, SHOWN_M)
    assert (bench.photos, bench.bin.state) == (4, State.CONFIRMED)
    assert len(bench.attested) == 2

    bench.run(3.0)
    bench.labels = [UNKNOWN] * 3
    bench.run(3.0, SHOWN_M)
    assert bench.attested[-1].model_dump()["class"] == UNKNOWN


def refused() -> Bench:
    """A bin that has looked at an item of which it takes no more."""
    bench = Bench()
    bench.run(1.0)
    bench.drop("yellow", CONFIG.full_at_n)
    bench.run(2.0)
    bench.labels = ["plastic"]
    bench.run(2.0, SHOWN_M)
    assert bench.bin.state is State.FULL
    return bench


def test_what_was_refused_and_stays_in_view_is_refused_once() -> None:
    bench = refused()
    for _ in range(10):
        bench.run(5.0, SHOWN_M)
        bench.run(5.0, SHOWN_M + 0.1)
        bench.run(0.3)
    assert (bench.photos, bench.bin.state) == (1, State.FULL)


def test_what_comes_after_a_refused_item_is_looked_at() -> None:
    bench = refused()
    bench.run(0.7)
    bench.labels = ["glass"]
    bench.run(2.0, SHOWN_M)
    assert bench.bin.state is State.AWAITING_DROP


def test_what_comes_after_a_time_out_is_looked_at_and_what_is_still_there_is_not() -> None:
    bench = shown("plastic")
    bench.run(250.0, SHOWN_M)
    assert (bench.photos, bench.bin.state) == (1, State.TIMED_OUT)
    bench.run(0.7)
    bench.labels = ["glass"]
    bench.run(2.0, SHOWN_M)
    assert bench.bin.state is State.AWAITING_DROP


@pytest.mark.parametrize("state", [State.ITEM_SEEN, State.CLASSIFYING])
def test_a_restart_while_looking_looks_again_also_with_a_drop_awaited(state: State) -> None:
    bench = shown("plastic")
    bench.bin.memory.state = state
    bench = restarted(bench, down_s=5.0)
    bench.labels = ["glass"]
    bench.run(20.0, SHOWN_M)
    assert (bench.photos, bench.bin.state) == (1, State.AWAITING_DROP)
    assert bench.attested[-1].model_dump()["class"] == "glass"


def test_a_restart_while_looking_at_what_is_gone_goes_on_waiting() -> None:
    bench = shown("plastic")
    bench.bin.memory.state = State.CLASSIFYING
    bench = restarted(bench, down_s=5.0)
    bench.run(2.0)
    assert bench.bin.state is State.AWAITING_DROP
    bench.drop("yellow")
    bench.run(2.0)
    (disposed,) = disposals(bench)
    assert disposed.correct


def claimant(name: str, recording: str = "cd") -> Claimant:
    address = "0x" + ("aa" if name == "panther1" else "bb") * 20
    return Claimant(device=name, address=address, recording="0x" + recording * 32, task_id=7, attempt=1)


def test_classification_and_drop_name_the_robot_that_presented_itself() -> None:
    bench = Bench()
    bench.run(2.0)
    bench.bin.showing.presented(claimant("panther1", "ab"), bench.time_s)
    bench.bin.showing.presented(claimant("panther1"), bench.time_s)
    bench.labels = ["plastic"]
    bench.run(5.0, SHOWN_M)
    bench.run(3.0)
    bench.drop("yellow")
    bench.run(1.5)
    classified, dropped = bench.attested
    assert isinstance(classified, ClassificationRecord) and isinstance(dropped, DropRecord)
    assert classified.claimants == dropped.claimants == (claimant("panther1"),)


def test_of_two_robots_that_present_themselves_the_bin_names_both() -> None:
    bench = Bench()
    bench.run(2.0)
    bench.bin.showing.presented(claimant("panther1"), bench.time_s)
    bench.bin.showing.presented(claimant("panther2"), bench.time_s)
    bench.labels = ["plastic"]
    bench.run(5.0, SHOWN_M)
    (classified,) = bench.attested
    assert isinstance(classified, ClassificationRecord)
    assert [one.device for one in classified.claimants] == ["panther2", "panther1"]


def test_who_presented_itself_long_ago_or_for_another_item_is_not_named() -> None:
    bench = Bench()
    bench.run(2.0)
    bench.bin.showing.presented(claimant("panther1"), bench.time_s)
    bench.run(130.0)
    bench.labels = ["plastic"]
    bench.run(5.0, SHOWN_M)
    bench.bin.showing.presented(claimant("panther1"), bench.time_s)
    bench.run(3.0)
    bench.drop("yellow")
    bench.run(5.0)
    bench.labels = ["plastic"]
    bench.run(5.0, SHOWN_M)
    late, dropped, another = bench.attested
    assert isinstance(late, ClassificationRecord) and isinstance(another, ClassificationRecord)
    assert isinstance(dropped, DropRecord)
    assert (late.claimants, dropped.claimants, another.claimants) == ((), (), ())


def test_weight_that_leaves_a_compartment_is_stated() -> None:
    bench = shown("plastic")
    bench.run(3.0)
    bench.drop("yellow")
    bench.run(3.0)
    bench.drop("yellow", -0.3)
    bench.run(3.0)
    removed = bench.attested[-1]
    assert isinstance(removed, RemovalRecord)
    assert (removed.compartment, removed.weight_n) == ("yellow", 0.3)
    assert len(bench.attested) == 3


def test_a_container_that_is_put_back_removes_nothing() -> None:
    bench = shown("plastic")
    bench.run(3.0)
    bench.drop("yellow")
    bench.run(3.0)
    bench.drop("yellow", -5.0)
    bench.run(3.0)
    bench.drop("yellow", 5.0)
    bench.run(3.0)
    assert sum(isinstance(record, RemovalRecord) for record in bench.attested) == 1


class Looks(Bench):
    """A bin whose network says what is in `answers`, each of another picture unless its hash is given."""

    def __init__(self, *answers: Classification, hashes: tuple[str, ...] = ()) -> None:
        super().__init__()
        self.answers = list(answers)
        self.hashes = hashes or tuple(f"0x{number:064x}" for number in range(20))
        self.run(2.0)

    def _do(self, actions: list[Action]) -> None:
        for action in actions:
            if isinstance(action, Attest):
                self.keep(action.record)
                continue
            sha256 = self.hashes[self.photos]
            answer = self.answers[min(self.photos, len(self.answers) - 1)]
            self.photos += 1
            self._do(self.bin.photo(answer, sha256, self.time_s))

    def show(self) -> ClassificationRecord:
        """Show an item from some angle for as long as it takes, then draw back; what was said last."""
        self.run(5.0, SHOWN_M)
        self.run(2.0)
        said = self.attested[-1]
        assert isinstance(said, ClassificationRecord)
        return said


def test_a_sure_answer_takes_one_picture() -> None:
    bench = Looks(seen(0.95))
    said = bench.show()
    assert (bench.photos, said.item_class, said.earlier, said.another_angle) == (1, "plastic", (), False)


def test_unsure_pictures_are_combined_as_they_come_and_all_are_named() -> None:
    bench = Looks(seen(0.4), seen(0.7), seen(0.95))
    said = bench.show()
    assert (bench.photos, said.item_class) == (3, "plastic")
    assert [look.image_sha256 for look in said.earlier] == [*bench.hashes[:2]]
    assert said.image_sha256 == bench.hashes[2]
    # The geometric means of 0.4, 0.7, 0.95 and of 0.6, 0.3, 0.05, scaled to one.
    assert said.probabilities["plastic"] == pytest.approx(0.7556, abs=1e-4)
    assert not said.another_angle


def test_a_picture_that_comes_again_counts_once() -> None:
    bench = Looks(seen(0.6), hashes=(SHA,) * 9)
    said = bench.show()
    assert (bench.photos, said.earlier, said.image_sha256) == (3, (), SHA)
    assert said.probabilities["plastic"] == 0.6


def test_what_stays_unsure_is_asked_for_from_another_angle_up_to_a_named_number() -> None:
    bench = Looks(seen(0.55))
    asked = [bench.show() for _ in range(4)]
    assert [one.another_angle for one in asked[:3]] == [True, True, False]
    assert [len(one.earlier) for one in asked] == [2, 5, 8, 2]  # the fourth is looked at afresh


def test_another_angle_is_combined_with_the_first() -> None:
    bench = Looks(*[seen(0.45)] * 3, seen(0.99))
    first, second = bench.show(), bench.show()
    assert (first.item_class, first.another_angle) == ("paper", True)
    assert (second.item_class, len(second.earlier)) == ("plastic", 3)


def test_what_somebody_shows_a_while_after_somebody_else_is_not_combined_although_nobody_is_known() -> None:
    bench = Looks(seen(0.55))
    assert bench.show().another_angle
    bench.run(15.0)
    assert [look.taken_s > bench.time_s - 8 for look in bench.show().earlier] == [True, True]


def test_whoever_was_asked_for_another_angle_hears_of_each_that_is_shown_although_it_is_worse() -> None:
    bench = Looks(*[seen(0.62, item=0.95)] * 3, seen(0.62, item=0.05))
    said = [bench.show() for _ in range(3)]
    assert [one.number for one in said] == [1, 2, 3]
    assert [one.item_class for one in said] == ["plastic", UNKNOWN, UNKNOWN]
    assert [one.another_angle for one in said] == [True, True, False]


def test_what_another_robot_shows_is_not_combined_with_what_was_shown_before() -> None:
    bench = Looks(seen(0.55))
    other = Claimant(device="b", address="0x" + "22" * 20, recording="0x" + "33" * 32, task_id=9, attempt=1)
    bench.show()
    bench.bin.showing.presented(other, bench.time_s)
    assert [look.taken_s > bench.time_s - 8 for look in bench.show().earlier] == [True, True]


def test_what_a_robot_shows_that_began_again_is_not_combined_with_pictures_of_its_last_recording() -> None:
    bench = Looks(seen(0.55))
    bench.bin.showing.presented(claimant("panther1", "ab"), bench.time_s)
    bench.show()
    bench.bin.showing.presented(claimant("panther1", "cd"), bench.time_s)
    assert [look.taken_s > bench.time_s - 8 for look in bench.show().earlier] == [True, True]


def present(bench: Bench, name: str, grasped_s: float = 0.0, recording: str = "cd") -> None:
    bench.bin.showing.presented(claimant(name, recording), bench.time_s, grasped_s)


def test_what_a_robot_grasped_anew_is_not_combined_with_pictures_from_before_the_grasp() -> None:
    bench = Looks(seen(0.55))
    present(bench, "panther1", grasped_s=990.0)
    bench.show()
    bench.run(30.0)
    grasped_s = bench.time_s
    present(bench, "panther1", grasped_s)
    assert [look.taken_s > grasped_s for look in bench.show().earlier] == [True, True]


def test_what_a_robot_grasped_anew_is_said_to_be_unknown_although_it_was_known_before() -> None:
    bench = Looks(seen(0.95), seen(0.95, item=0.05))
    present(bench, "panther1", grasped_s=990.0)
    assert bench.show().item_class == "plastic"
    present(bench, "panther1", bench.time_s)
    assert bench.show().item_class == UNKNOWN


def test_a_robot_is_asked_for_a_named_number_of_angles_whoever_else_presents_itself() -> None:
    bench = Looks(seen(0.55))
    said = []
    for number in range(5):
        present(bench, "panther1")
        said.append(bench.show())
        present(bench, "panther2", recording=f"{number:02x}")
    assert [one.another_angle for one in said] == [True, True, False, False, False]
    assert [len(one.earlier) for one in said[:3]] == [2, 5, 8]


def test_two_robots_that_take_turns_are_asked_for_no_more_angles() -> None:
    bench = Looks(seen(0.55))
    said = []
    for number in range(6):
        present(bench, "panther1")
        present(bench, "panther2", recording=f"{number:02x}")
        said.append(bench.show())
    assert [one.another_angle for one in said] == [True, True, False, False, False, False]


def test_an_angle_goes_on_although_another_robot_presented_itself_too_long_ago_by_now() -> None:
    bench = Looks(seen(0.55))
    present(bench, "panther2")
    bench.run(110.0)
    present(bench, "panther1")
    assert len(bench.show().claimants) == 2
    bench.run(5.0)
    present(bench, "panther1")
    said = bench.show()
    assert (len(said.claimants), len(said.earlier)) == (1, 5)


def test_what_another_robot_shows_is_not_combined_although_the_one_before_it_is_still_named() -> None:
    bench = Looks(seen(0.55))
    present(bench, "panther1")
    bench.show()
    present(bench, "panther2")
    said = bench.show()
    assert (len(said.claimants), len(said.earlier)) == (2, 2)


def test_a_robot_that_says_each_time_that_it_grasped_anew_is_asked_no_more_often_than_it_may_grasp() -> None:
    bench = Looks(seen(0.55), hashes=tuple(f"0x{number:064x}" for number in range(99)))
    asked = 0
    for number in range(12):
        if number == 3:  # after a restart, too
            memory = Memory.model_validate_json(bench.bin.memory.model_dump_json())
            bench.bin = Bin(CONFIG, memory)
            bench.run(2.0)
        present(bench, "panther1", grasped_s=float(number))
        asked += bench.show().another_angle
    assert asked == 8


def test_what_is_shown_after_a_drop_is_not_combined_with_what_fell() -> None:
    bench = Looks(seen(0.55))
    said = bench.show()
    bench.drop(said.compartment)
    bench.run(5.0)
    assert len(bench.show().earlier) == 2


def test_pictures_are_named_in_the_order_of_their_times_although_the_cameras_clock_steps_back() -> None:
    bin_ = Bench().bin
    for offset_s in (0.0, 5.0, 3.0):
        bin_.memory.state = State.CLASSIFYING
        told = bin_.photo(seen(0.55), f"0x{int(offset_s):064x}", 1000.0 + offset_s)
    (action,) = told
    assert isinstance(action, Attest) and isinstance(action.record, ClassificationRecord)
    assert [look.taken_s for look in action.record.earlier] == [1000.0, 1003.0]
    assert action.record.shown_s == 1005.0
