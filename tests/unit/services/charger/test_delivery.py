"""A delivery: what the meter signs, when the contactor opens, and what a restart leaves."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.messages import ClockOffset
from rodeo.charging.metering import STEP_WH
from rodeo.charging.orders import ChargingParams
from rodeo.evidence.attestation import Attestation, attest
from rodeo.evidence.proof import open_proof
from rodeo.evidence.seal import Binding
from rodeo.host.clock import WallClock
from rodeo.recording.statements import Heard
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.types import new, serialize
from rodeo.witness.chain import WitnessChain
from rodeo.witness.devices import Device
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Head, MeterRecord, Receipt, Scope, digest, parse
from rodeo.witness.witness import unverified_seal
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_testing.assignments import CHARGE_BINDING, METER, ROBOT
from rodeo_testing.recordings import Take
from services.charger.delivery import Delivery, Order
from services.charger.job import Job
from services.charger.lies import RegisterFrozen
from services.charger.session import End, Phase, SessionLimits, SessionState, is_handed_in

START_S = 1_900_000_000
BATTERY = "sensor_msgs/msg/BatteryState"
ADDRESS = {"address": ROBOT.address, "role": "robot", "name": "panther1", "owner": "0x" + "00" * 20}


class Clock(WallClock):
    def __init__(self) -> None:
        super().__init__()
        self.time_s = float(START_S)
        self.named_s: float | None = None
        """Up to when somebody waits."""

    def now_ns(self) -> int:
        return round(self.time_s * 1e9)

    def now_s(self) -> float:
        return self.time_s

    def wait_until(self, time_s: float, stop: object = None) -> bool:
        return True

    def wait_for(self, *args: Any, until_s: float | None = None, **how: Any) -> bool:
        self.named_s = until_s
        return super().wait_for(*args, until_s=until_s, **how)


class Bench:
    """A dock whose terminals deliver 420 W while the contactor is closed, and a robot that signs."""

    def __init__(self, folder: Path, register_wh: float = 0.0) -> None:
        self.folder = folder
        self.clock = Clock()
        self.published: list[Attestation] = []
        self.signs = True
        self.listens = True
        self.soc = 0.86
        self.scope = Scope(
            chain_id=CHARGE_BINDING.chain_id,
            task_manager=CHARGE_BINDING.task_manager,
            organization=CHARGE_BINDING.organization,
        )
        self.robot = WitnessChain(
            "panther1", ROBOT, self.scope, "sensor", Journal(folder / "robot.jsonl"), HeadBook()
        )
        task = charging_chain_record(Take([_Moment(START_S)])).task  # type: ignore[list-item]
        self.job = Job(task=task, session=SessionState(wait_until_s=START_S + 1800))
        self.closed = False
        self.delivered_wh = 0.0
        self.sequence = 0
        self.current_a: Callable[[float], float] = lambda _time_s: 10.0
        """While the contactor is closed, by the seconds since the beginning."""
        self.start()

    def start(self, binding: Binding = CHARGE_BINDING) -> None:
        """The process begins, or begins again."""
        journal = Journal(self.folder / "meter.jsonl")
        chain = WitnessChain("dock1", METER, self.scope, "closed_bus", journal, HeadBook())
        params = ChargingParams.model_validate(self.job.task.params)
        limits = SessionLimits(42.0, 0.1, params.energy_wh, params.soc_target, START_S + 14_000)
        order = Order(
            job=Job.model_validate_json(self.job.model_dump_json()),
            params=params,
            limits=limits,
            binding=binding,
            path=self.folder / f"{binding.attempt}.mcap",
            register=self.folder / "register.json",
            battery_topic="panther1/battery_state",
            slack_s=60.0,
            offset=ClockOffset(source="router", off_s=0.01, doubt_s=0.001),
        )
        self.delivery = Delivery(order, chain, self._heard, METER, self.clock, self._saved, self._hear_seal)

    def _hear_seal(self, data: bytes) -> None:
        if self.listens:
            self.robot.heads.hear(unverified_seal(data).spoken.head)

    def _saved(self, job: Job) -> None:
        self.job = Job.model_validate_json(job.model_dump_json())

    def _heard(self, signed: Attestation) -> None:
        self.published.append(signed)
        if self.signs:
            self.answer(signed)

    def answer(self, signed: Attestation, **changes: Any) -> Attestation:
        record = parse(signed.payload)
        assert isinstance(record, MeterRecord)
        fields = {
            "task_id": record.task_id,
            "attempt": record.attempt,
            "recording": record.recording,
            "meter": record.device,
            "meter_address": METER.address,
            "record": digest(signed),
            "begin_wh": record.begin_wh,
            "register_wh": record.register_wh,
            "soc": self.soc,
            "reason": record.reason if record.reason in ("opening", "close") else "step",
        }
        receipt = self.robot.sign(Receipt, self.clock.now_s(), **(fields | changes))
        self.delivery.on_receipt(
            Heard(Device.model_validate(ADDRESS), receipt.model_dump(), parse(receipt.payload))
        )
        return receipt

    def run(self, seconds: int) -> None:
        for _ in range(seconds):
            self.clock.time_s += 1.0
            current_a = self.current_a(self.clock.time_s - START_S) if self.closed else 0.0
            self.delivered_wh += 42.0 * current_a / 3600
            stamp = new("builtin_interfaces/msg/Time", sec=int(self.clock.time_s))
            header = new("std_msgs/msg/Header", stamp=stamp)
            message = new(BATTERY, header=header, voltage=42.0, current=current_a, present=True)
            self.sequence += 1
            info = MessageInfo(serialize(message), self.clock.now_ns(), self.sequence, b"dock")
            self.delivery.on_output(message, info)
            self.delivery.wait(0.0)
            if self.delivery.session.commands_contactor:
                self.closed = self.delivery.session.contactor_wanted
                self.delivery.contactor(self.closed)

    @property
    def records(self) -> list[MeterRecord]:
        said = [parse(one.payload) for one in self.published]
        return [one for one in said if isinstance(one, MeterRecord)]

    @property
    def phase(self) -> Phase:
        return self.delivery.session.state.phase


class _Moment:
    def __init__(self, time_s: int) -> None:
        self.time_ns = time_s * 10**9


def test_the_register_is_recorded_at_least_every_step_and_no_reading_is_lost(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(400)
    steps = [b.register_wh - a.register_wh for a, b in zip(bench.records, bench.records[1:], strict=False)]
    assert bench.records[0].reason == "opening"
    assert max(steps) <= STEP_WH
    assert bench.delivery.receipted_wh == bench.records[-1].register_wh
    assert bench.phase is Phase.CHARGING


@pytest.mark.parametrize("signed_s", [100, 2000], ids=["until the robot is silent", "until all is delivered"])
def test_the_dock_acts_at_no_reading_that_it_did_not_name_and_names_few(
    tmp_path: Path, signed_s: int
) -> None:
    bench = Bench(tmp_path)
    named_s, acts = set[float | None](), 0
    while not bench.delivery.session.ended and bench.clock.time_s < START_S + 1000:
        bench.signs = bench.clock.time_s < START_S + signed_s
        bench.delivery.wait(0.0)
        due_s, before = bench.clock.named_s, (bench.phase, len(bench.published))
        bench.run(1)
        named_s.add(due_s)
        if (bench.phase, len(bench.published)) != before:
            acts += 1
            # The first reading is the one that nobody can name.
            assert due_s is None or due_s <= bench.clock.time_s
    assert acts > 5
    waiting = 0 if signed_s == 2000 else 900  # for a receipt each reading may be the one that decides
    assert len(named_s) <= 3 * acts + waiting


@pytest.mark.parametrize("changes_s", [-900.0, 900.0], ids=["power that falls", "power that rises"])
def test_a_dock_names_each_reading_once_also_when_the_power_changes(tmp_path: Path, changes_s: float) -> None:
    """A battery that is nearly full takes less and less: a simulated clock need not stop before."""
    bench = Bench(tmp_path)
    bench.current_a = lambda time_s: 10.0 * math.exp(time_s / changes_s)
    named_s, acts = set[float | None](), 0
    for _ in range(600):
        bench.delivery.wait(0.0)
        due_s, before = bench.clock.named_s, len(bench.published)
        bench.run(1)
        if due_s is not None and due_s <= bench.clock.time_s:
            named_s.add(due_s)
        if len(bench.published) != before:
            acts += 1
            assert due_s is None or due_s <= bench.clock.time_s
    assert acts >= 20
    # Its limit is a little early, so that no reading is missed.
    assert len(named_s) <= 1.25 * acts


def test_silence_opens_the_contactor_one_step_after_the_last_receipt(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(100)
    bench.signs = False
    bench.run(300)
    assert (bench.phase, bench.closed) == (Phase.AWAITING_RECEIPT, False)
    unsigned_wh = bench.delivery.energy_wh - bench.delivery.receipted_wh
    assert STEP_WH <= unsigned_wh < STEP_WH + 0.25
    assert bench.records[-1].reason == "pause"
    assert bench.delivery.session.state.end is None


def test_the_wait_for_the_terminals_ends_when_something_else_is_to_be_done(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(100)
    bench.delivery.wait(60.0, lambda: True)
    assert bench.phase is Phase.CHARGING


def test_the_contactor_closes_again_with_the_next_receipt(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(100)
    bench.signs = False
    bench.run(300)
    bench.signs = True
    bench.answer(bench.published[-1])
    bench.run(5)
    assert (bench.phase, bench.closed) == (Phase.CHARGING, True)


def test_readings_that_come_after_the_contactor_opened_are_signed_for_too(tmp_path: Path) -> None:
    """A fast clock's readings are late: the dock says that it is open before the last of them are here."""
    bench = Bench(tmp_path)
    bench.run(100)
    bench.signs = False
    bench.run(300)
    late_s = bench.clock.time_s
    bench.closed = True  # for the readings that are on their way
    bench.run(60)
    assert bench.phase is Phase.AWAITING_RECEIPT
    bench.closed = False
    bench.signs = True
    bench.answer(bench.published[-1])
    bench.run(5)
    assert bench.phase is Phase.CHARGING
    assert bench.clock.time_s < late_s + 100


@pytest.mark.parametrize(
    "lie",
    [
        {"register_wh": 9999.0},
        {"record": "0x" + "11" * 32},
        {"recording": "0x" + "11" * 32},
        {"begin_wh": 0.0001},
        {"task_id": 99},
        {"attempt": 2},
        {"meter": "dock9"},
        {"meter_address": ROBOT.address},
    ],
)
def test_a_receipt_for_what_was_not_recorded_closes_nothing(tmp_path: Path, lie: dict[str, Any]) -> None:
    bench = Bench(tmp_path)
    bench.run(100)
    bench.signs = False
    bench.run(300)
    bench.answer(bench.published[-1], **lie)
    bench.run(5)
    assert bench.phase is Phase.AWAITING_RECEIPT


def test_a_robot_that_never_lists_the_recording_gets_one_step(tmp_path: Path) -> None:
    """Its receipts would prove nothing."""
    bench = Bench(tmp_path)
    bench.listens = False
    bench.robot.heads.take()
    bench.run(600)
    assert bench.phase is Phase.AWAITING_RECEIPT
    assert bench.delivered_wh < STEP_WH + 0.25
    assert len(bench.records) < 60
    bench.listens = True
    bench.run(60)
    assert bench.phase is Phase.CHARGING


def test_a_receipt_that_lists_a_seal_of_another_recording_is_not_on_record(tmp_path: Path) -> None:
    """Otherwise the buyer says that there is another version of the seller's recording."""
    bench = Bench(tmp_path)
    bench.run(50)
    last, before = bench.published[-1], bench.delivery.receipted_wh
    recording = bench.delivery.recording
    invented = Head(
        device="dock1", address=METER.address, chain=recording, index=10**6, digest="0x" + "11" * 32
    )
    bench.robot.heads.hear(invented)
    bench.answer(last)
    bench.delivery.stop(End.CANCELLED)
    assert bench.delivery.receipted_wh == before
    proof = open_proof(bench.delivery.seal().path)
    assert not any(invented.digest in str(one.payload["heads"]) for one in proof.attestations()), (
        "the receipt is on record"
    )


def test_a_second_receipt_under_one_number_is_not_on_record(tmp_path: Path) -> None:
    """Otherwise a buyer turns its own charge undecided whenever it likes."""
    bench = Bench(tmp_path)
    bench.run(50)
    signed = parse(bench.answer(bench.published[-1]).payload)
    assert isinstance(signed, Receipt)
    other = attest(signed.model_copy(update={"soc": 0.5}).model_dump(mode="json"), ROBOT)
    bench.delivery.on_receipt(Heard(Device.model_validate(ADDRESS), other.model_dump(), parse(other.payload)))
    bench.delivery.stop(End.CANCELLED)
    proof = open_proof(bench.delivery.seal().path)
    numbers = [one.payload["seq"] for one in proof.attestations() if one.payload["type"] == "robot.receipt"]
    assert len(numbers) == len(set(numbers))


def test_the_session_ends_when_the_ordered_energy_is_delivered_and_the_robot_signs_it(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(1000)
    assert bench.delivery.session.ended
    assert bench.delivery.session.state.end is End.ENERGY_LIMIT
    bench.delivery.close_session()
    assert bench.delivery.wait_closed(0.0)
    assert bench.records[-1].reason == "close"
    proof = open_proof(bench.delivery.seal().path)
    assert proof.events()[-2]["closed_by_robot"] is True


def test_a_robot_that_never_signs_the_close_pays_what_it_signed_last(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(200)
    bench.signs = False
    bench.delivery.stop(End.CANCELLED)
    bench.run(2)
    bench.delivery.close_session()
    assert not bench.delivery.wait_closed(0.0)
    assert 0 < bench.delivery.receipted_wh <= bench.delivery.energy_wh


def test_the_register_goes_on_in_the_next_session(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(1000)
    bench.delivery.close_session()
    bench.delivery.seal()
    first_wh = bench.records[-1].register_wh
    bench.job.session = SessionState(wait_until_s=bench.clock.time_s + 1800)
    bench.job.task = bench.job.task.model_copy(update={"attempt": 2})
    bench.start(CHARGE_BINDING.model_copy(update={"attempt": 2}))
    bench.run(200)
    assert bench.records[-1].begin_wh == first_wh > 0
    assert bench.records[-1].register_wh > first_wh


def test_what_a_meter_showed_until_it_was_caught_is_recorded_and_never_sold(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(100)
    assert bench.delivery.receipted_wh > 0
    bench.delivery.disbelieve(RegisterFrozen("the register stands still", by_power_wh=12.0))
    bench.run(3)
    assert (bench.phase, bench.closed) == (Phase.ENDED, False)
    said = {
        "code": "register_frozen",
        "message": "the register stands still",
        "details": {"by_power_wh": 12.0},
    }
    state = bench.job.session
    assert (state.end, state.lie, state.sold) == (End.METER_LIES, said, True)
    assert not any(is_handed_in(state, in_grace) for in_grace in (True, False))
    events = {one["event"]: one for one in open_proof(bench.delivery.seal().path).events() if "lie" in one}
    assert events["meter_lies"]["lie"] == said
    assert (events["session_ended"]["reason"], events["session_ended"]["lie"]) == ("meter_lies", said)
    assert "close" not in [one.reason for one in bench.records]


def test_a_session_that_sold_nothing_is_handed_in_only_where_giving_it_back_costs() -> None:
    state = SessionState(wait_until_s=0.0, end=End.NO_ROBOT)
    assert [is_handed_in(state, in_grace) for in_grace in (True, False)] == [False, True]
    assert is_handed_in(state.model_copy(update={"sold": True}), in_grace=True)


def test_a_restarted_charger_goes_on_with_register_pages_and_receipts(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(203)
    counted_wh, pages = bench.delivery.energy_wh, bench.records[-1].page
    bench.delivery.suspend()
    bench.start()
    assert bench.delivery.energy_wh == pytest.approx(counted_wh, abs=1e-3)
    bench.run(60)
    assert [one.page for one in bench.records] == list(range(1, bench.records[-1].page + 1))
    assert bench.records[-1].page > pages
    assert bench.phase is Phase.CHARGING


def test_a_record_that_was_signed_and_not_recorded_is_recorded_after_the_restart(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run(203)
    last = bench.published[-1]
    bench.delivery.suspend()
    journal = Journal(tmp_path / "meter.jsonl")
    record = last.payload | {
        "seq": last.payload["seq"] + 1,
        "previous": digest(last),
        "page": last.payload["page"] + 1,
        "register_wh": last.payload["register_wh"] + 1.0,
        "readings": "",
    }
    journal.add(attest(record, METER))
    journal.close()
    bench.start()
    assert bench.delivery.energy_wh == pytest.approx(record["register_wh"] - record["begin_wh"], abs=0.5)
    bench.run(60)
    bench.delivery.stop(End.CANCELLED)
    proof = open_proof(bench.delivery.seal().path)
    said = [parse(one.payload) for one in proof.attestations()]
    pages = [one.page for one in said if isinstance(one, MeterRecord)]
    assert pages == list(range(1, len(pages) + 1))


def test_a_robot_with_another_charge_than_its_task_says_is_not_served(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.soc = 0.99
    bench.run(20)
    assert bench.delivery.session.state.end is End.OTHER_CHARGE
    assert bench.delivered_wh == 0.0
